# Configures the project beside this file with each link that is forbidden, which must fail, and without, which must not.
foreach(link IN ITEMS none direct reverse by_another alias condition objects both below)
  file(REMOVE_RECURSE ${scratch})
  execute_process(
    COMMAND ${CMAKE_COMMAND} -G Ninja -S ${source} -B ${scratch} -D link=${link} -D separation=${separation}
    RESULT_VARIABLE status OUTPUT_QUIET ERROR_VARIABLE errors
  )
  if(link STREQUAL none)
    if(NOT status EQUAL 0)
      message(FATAL_ERROR "no link is forbidden, yet:\n${errors}")
    endif()
  elseif(status EQUAL 0 OR NOT errors MATCHES "links the simulator")
    message(FATAL_ERROR "${link}: status ${status}\n${errors}")
  endif()
endforeach()
