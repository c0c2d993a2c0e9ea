# Toolchain of the LF2407A: TI's C compiler for the C24x, version 7.04 (dspcl), found through the
# environment variable C24X_ROOT or on the path. Written from its manual (SPRU024), never run.
set(CMAKE_SYSTEM_NAME Generic)
set(CMAKE_SYSTEM_PROCESSOR tms320lf2407a)
# CMake has no model of this compiler and its link step needs a command file.
set(CMAKE_TRY_COMPILE_TARGET_TYPE STATIC_LIBRARY)
set(CMAKE_C_COMPILER_WORKS TRUE)
set(CMAKE_C_COMPILER_ID_RUN TRUE)
set(CMAKE_C_COMPILER_FORCED TRUE)

find_program(OMNISLIP_COMPILER dspcl HINTS ENV C24X_ROOT PATH_SUFFIXES bin REQUIRED)
find_program(OMNISLIP_LINKER dsplnk HINTS ENV C24X_ROOT PATH_SUFFIXES bin REQUIRED)
set(CMAKE_C_COMPILER ${OMNISLIP_COMPILER})

# -v2xx core; -o2 optimise; -pw2 all warnings; -fo the next name is the object's. Interrupt routines
# and what they call must not be compiled with -oe, so -o3 with its guesses is left alone.
set(CMAKE_C_OUTPUT_EXTENSION .obj)
set(CMAKE_C_COMPILE_OBJECT
    "<CMAKE_C_COMPILER> -q -c -v2xx -o2 -pw2 <DEFINES> <INCLUDES> -fo<OBJECT> <SOURCE>")
