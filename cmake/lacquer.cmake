# Compiler settings of every target of ours. No -march (breaks at Debian's Eigen/Ceres boundary), no -ffast-math (kills NaN checks).
add_library(lacquer_options INTERFACE)
target_compile_options(lacquer_options INTERFACE "$<BUILD_INTERFACE:-Wall;-Wextra;-Wpedantic;-Wconversion;-Wno-sign-conversion;-fno-math-errno;-Wno-restrict>")
# -Wno-restrict: g++ 12 warns falsely on std::string + char* (GCC PR 105651)
target_compile_features(lacquer_options INTERFACE cxx_std_20)
target_include_directories(lacquer_options INTERFACE $<BUILD_INTERFACE:${CMAKE_SOURCE_DIR}> $<INSTALL_INTERFACE:include/lacquer>)
if(LACQUER_WERROR)
  target_compile_options(lacquer_options INTERFACE -Werror)
endif()
if(LACQUER_ASSERTS)
  string(REPLACE "-DNDEBUG" "" CMAKE_CXX_FLAGS_RELWITHDEBINFO "${CMAKE_CXX_FLAGS_RELWITHDEBINFO}")
endif()
if(LACQUER_SANITIZE)
  # Debian's Ceres is built without the sanitizer: Eigen must use the same allocator on both sides of the boundary.
  # Left out are the checks on every member access, which double the time of a build: AddressSanitizer finds null pointers too.
  target_compile_options(lacquer_options INTERFACE -fsanitize=address,undefined -fno-sanitize-recover=undefined
                                                   -fno-sanitize=null,alignment,object-size,vptr
                                                   -fno-omit-frame-pointer)
  target_compile_definitions(lacquer_options INTERFACE EIGEN_MALLOC_ALREADY_ALIGNED=1)
  target_link_options(lacquer_options INTERFACE -fsanitize=address,undefined)
endif()

# lacquer_precompile(<target> <header>...): what most files of the target include and what takes long to read.
function(lacquer_precompile target)
  if(LACQUER_PCH)
    target_precompile_headers(${target} PRIVATE ${ARGN} <algorithm> <filesystem> <fmt/format.h> <functional> <map> <memory> <optional> <string> <vector>)
  endif()
endfunction()
if(LACQUER_FUZZ)
  target_compile_options(lacquer_options INTERFACE -fsanitize=fuzzer-no-link,address)
  target_link_options(lacquer_options INTERFACE -fsanitize=address)
endif()

# lacquer_library(<name> SOURCES ... PUBLIC ... PRIVATE ...): a static library lacquer_<name>, alias lacquer::<name>.
function(lacquer_library name)
  cmake_parse_arguments(ARG "" "" "SOURCES;PUBLIC;PRIVATE" ${ARGN})
  add_library(lacquer_${name} STATIC ${ARG_SOURCES})
  # JSON is read and written once per command: optimising it only makes the build longer.
  set(json_sources ${ARG_SOURCES})
  list(FILTER json_sources INCLUDE REGEX "_json\\.cpp$")
  set_source_files_properties(${json_sources} PROPERTIES COMPILE_OPTIONS $<$<CONFIG:Release>:-O1>)
  add_library(lacquer::${name} ALIAS lacquer_${name})
  target_link_libraries(lacquer_${name} PUBLIC lacquer_options ${ARG_PUBLIC} PRIVATE ${ARG_PRIVATE})
  lacquer_precompile(lacquer_${name} <fstream>)
endfunction()
