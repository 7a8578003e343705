# Builds the shared library for release:
#   cmake -DROOT=<sources> -DTARGET=<cargo's folder> -P build_library.cmake
# Leaves TARGET/release/libspivcal.so; with -DTRIPLE=x86_64-pc-windows-gnu TARGET/x86_64-pc-windows-gnu/release/spivcal.dll.
# -DRUSTC="..." is another command than `cargo rustc`. No path of the machine that builds stays in the library, so that two machines with one compiler
# build the same bytes.
foreach(name ROOT TARGET)
  if(NOT ${name})
    message(FATAL_ERROR "build_library.cmake needs -D${name}=...")
  endif()
endforeach()
set(cargo_home "$ENV{CARGO_HOME}")
if(NOT cargo_home)
  set(cargo_home "$ENV{HOME}/.cargo")
endif()

function(run)
  execute_process(COMMAND ${ARGN} WORKING_DIRECTORY "${ROOT}" RESULT_VARIABLE failed)
  if(failed)
    message(FATAL_ERROR "failed: ${ARGN}")
  endif()
endfunction()

# The folder of a registry has a name that depends on where the crates were fetched from: it is replaced whole.
run(cargo fetch --quiet --locked)
file(GLOB registries "${cargo_home}/registry/src/*")
# A later prefix wins where two fit.
set(flags "--remap-path-prefix=${cargo_home}=cargo")
foreach(registry ${registries})
  list(APPEND flags "--remap-path-prefix=${registry}=crates")
endforeach()
list(APPEND flags "--remap-path-prefix=${ROOT}=spivcal" "--remap-path-prefix=${TARGET}=target")
# With the component rust-src, the standard library's own paths are those of this machine.
execute_process(COMMAND rustc --print sysroot OUTPUT_VARIABLE sysroot OUTPUT_STRIP_TRAILING_WHITESPACE)
execute_process(COMMAND rustc -vV OUTPUT_VARIABLE version)
if(version MATCHES "commit-hash: ([0-9a-f]+)")
  list(APPEND flags "--remap-path-prefix=${sysroot}/lib/rustlib/src/rust=/rustc/${CMAKE_MATCH_1}")
endif()
list(APPEND flags "-Cstrip=symbols")
# Encoded, since a folder may have blanks in its name.
string(ASCII 31 separator)
list(JOIN flags "${separator}" flags)
unset(ENV{RUSTFLAGS})
set(ENV{CARGO_ENCODED_RUSTFLAGS} "${flags}")
set(ENV{CARGO_TARGET_DIR} "${TARGET}")
if(NOT RUSTC)
  set(RUSTC cargo rustc)
endif()
if(TRIPLE)
  set(platform --target ${TRIPLE})
endif()
separate_arguments(RUSTC)
run(${RUSTC} ${platform} --quiet --lib --no-default-features --crate-type cdylib --release --locked)
