# Compiles a header alone, and twice, in one language standard: -DCOMPILER -DLANG (c or c++) -DSTD -DHEADER -DINCLUDE -DWORK
file(MAKE_DIRECTORY "${WORK}")
if(LANG STREQUAL "c")
  set(suffix c)
else()
  set(suffix cpp)
endif()
foreach(times 1 2)
  set(source "${WORK}/${HEADER}_${STD}_${times}.${suffix}")
  if(times EQUAL 1)
    file(WRITE "${source}" "#include \"${HEADER}\"\nint main(void) { return 0; }\n")
  else()
    file(WRITE "${source}" "#include \"${HEADER}\"\n#include \"${HEADER}\"\nint main(void) { return 0; }\n")
  endif()
  execute_process(
    COMMAND ${COMPILER} -x ${LANG} -std=${STD} -pedantic-errors -Wall -Wextra -Werror -fsyntax-only -I${INCLUDE} ${source}
    RESULT_VARIABLE failed ERROR_VARIABLE words)
  if(failed)
    message(FATAL_ERROR "${HEADER} does not compile as ${STD}:\n${words}")
  endif()
endforeach()
# The check itself: a header that does not compile must be refused.
file(WRITE "${WORK}/wrong_${STD}.${suffix}" "#include \"${HEADER}\"\nint main(void) { return spivcal_no_such_thing; }\n")
execute_process(
  COMMAND ${COMPILER} -x ${LANG} -std=${STD} -fsyntax-only -I${INCLUDE} ${WORK}/wrong_${STD}.${suffix}
  RESULT_VARIABLE failed ERROR_QUIET)
if(NOT failed)
  message(FATAL_ERROR "the compiler accepts anything")
endif()
