# Writes OUTPUT (build_info.h): the hash of every source under SOURCE_DIR, FLAGS and COMPILER.
file(GLOB_RECURSE sources RELATIVE ${SOURCE_DIR} ${SOURCE_DIR}/*.h ${SOURCE_DIR}/*.cpp)
list(SORT sources)
set(listing "")
foreach(source IN LISTS sources)
    file(SHA256 ${SOURCE_DIR}/${source} digest)
    string(APPEND listing "${digest}  ${source}\n")
endforeach()
string(SHA256 source_hash "${listing}")
set(text "#pragma once
// Written by cmake/build_info.cmake: what this build is made of (the engine fingerprint).
namespace matiere::build {
inline constexpr char kSourceHash[] = \"${source_hash}\";  // SHA-256 over core/**
inline constexpr char kFlags[] = \"${FLAGS}\";
inline constexpr char kCompiler[] = \"${COMPILER}\";
}  // namespace matiere::build
")
set(old "")
if(EXISTS ${OUTPUT})
    file(READ ${OUTPUT} old)
endif()
if(NOT old STREQUAL text)
    file(WRITE ${OUTPUT} "${text}")
endif()
