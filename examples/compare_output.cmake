# Runs ${program} and compares what it prints with the file ${expected}.
execute_process(COMMAND ${program} OUTPUT_VARIABLE output COMMAND_ERROR_IS_FATAL ANY)
file(READ ${expected} wanted)
if(NOT output STREQUAL wanted)
  message(FATAL_ERROR "expected:\n${wanted}\nprinted:\n${output}")
endif()
