# Runs `convoy sim` of a convoy that lies alone in a folder.
file(REMOVE_RECURSE ${scratch})
file(COPY ${convoy} DESTINATION ${scratch}/bin)
execute_process(COMMAND ${scratch}/bin/convoy sim --list-routes RESULT_VARIABLE status)
if(NOT status EQUAL 2)
  message(FATAL_ERROR "exit status ${status}")
endif()
