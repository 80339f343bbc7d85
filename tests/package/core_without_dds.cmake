# Configures the core in ${scratch}, where Fast DDS cannot be found, with ${compiler} and ${launcher}, and installs it; looks through
# every header that it reads for one of a middleware or of OpenCV. With ${whole}, it is built there from nothing; without, the library is
# the one which the build in ${tree} made of the same sources with the same options.
cmake_minimum_required(VERSION 3.25)

# run(COMMAND...): stops at the first failure.
function(run)
  execute_process(COMMAND ${ARGV} COMMAND_ECHO STDOUT COMMAND_ERROR_IS_FATAL ANY)
endfunction()

file(REMOVE_RECURSE ${scratch})
run(${CMAKE_COMMAND} -G Ninja -S ${source} -B ${scratch}/build
  -DCMAKE_BUILD_TYPE=${type}
  -DCMAKE_CXX_FLAGS=${flags}
  -DBUILD_SHARED_LIBS=${shared}
  -DCMAKE_CXX_COMPILER=${compiler}
  -DCMAKE_CXX_COMPILER_LAUNCHER=${launcher}
  -DCMAKE_INSTALL_PREFIX=${scratch}/prefix
  -DCMAKE_DISABLE_FIND_PACKAGE_fastrtps=ON
  -DCMAKE_DISABLE_FIND_PACKAGE_fastdds=ON
  -DCMAKE_DISABLE_FIND_PACKAGE_fastcdr=ON
  -DCONVOY_WITH_DDS=OFF
  -DCONVOY_BUILD_CLI=OFF
  -DCONVOY_BUILD_SIMULATOR=OFF
  -DCONVOY_BUILD_VISION=OFF
  -DCONVOY_BUILD_TESTS=OFF
  -DCONVOY_BUILD_EXAMPLES=OFF
)
if(whole)
  run(${CMAKE_COMMAND} --build ${scratch}/build)
  set(tree ${scratch}/build)
else()
  file(GLOB library ${tree}/src/libconvoy_core.*)  # one archive, or a shared library and the links to it
  file(COPY ${library} DESTINATION ${scratch}/build/src)
endif()

execute_process(COMMAND ninja -C ${tree} -t targets all OUTPUT_VARIABLE targets COMMAND_ERROR_IS_FATAL ANY)
string(REGEX MATCHALL "src/CMakeFiles/convoy_core.dir/[^\n:]*[.]o" objects "${targets}")
execute_process(COMMAND ninja -C ${tree} -t deps ${objects} OUTPUT_VARIABLE headers COMMAND_ERROR_IS_FATAL ANY)
if(NOT headers MATCHES "/Eigen/Core\n" OR NOT headers MATCHES "/convoy/submap/facts.hpp\n")
  message(FATAL_ERROR "the list of headers that were read is not complete:\n${headers}")
endif()
string(REPLACE "${source}/" "" headers "${headers}")  # whatever folders the project lies in
string(REGEX MATCH "[^\n]*(^|[ /])(fastdds|fastrtps|fastcdr|opencv2|idl|dds)/[^\n]*" found "${headers}")
if(found)
  message(FATAL_ERROR "convoy::core reads a header that it must not know:${found}")
endif()

run(${CMAKE_COMMAND} --install ${scratch}/build)
file(GLOB_RECURSE foreign ${scratch}/prefix/include/convoy/dds/* ${scratch}/prefix/*convoy-dds-targets*)
if(foreign)
  message(FATAL_ERROR "the installation of the core holds parts of the exchange: ${foreign}")
endif()
