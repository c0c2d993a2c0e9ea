#!/bin/sh
# Proves with Frama-C's Eva (Debian: frama-c-base) that no sequence of inputs, parameters and stored
# words makes the firmware do what C leaves undefined, on a machine with 16-bit int: no overflow, no
# division by zero, no index out of bounds, nothing read that was not written. Fails on any alarm and
# on any function that was not reached. Takes some minutes; the report stays in build/eva.log.
#
# Usage: tests/firmware/proof/prove.sh
cd "$(dirname "$0")/../../.." || exit 2
command -v "${FRAMA_C:=frama-c}" >/dev/null || {
    echo "prove.sh: no frama-c: run tools/setup --tests" >&2
    exit 2
}
mkdir -p build
# The octagon domain relates two variables, which saturating sums need; loops over wheels and axes are
# taken turn by turn.
"$FRAMA_C" -machdep gcc_x86_16 -cpp-extra-args="-I." -main eva_any_robot \
    -eva -eva-domains octagon -eva-auto-loop-unroll 100 \
    -eva-msg-key=-initial-state,-final-states \
    firmware/*.c tests/firmware/proof/eva_any_robot.c >build/eva.log 2>&1
grep --after-context=30 'ANALYSIS SUMMARY' build/eva.log
grep --after-context=4 'eva:alarm' build/eva.log
grep --quiet '  0 alarms generated' build/eva.log &&
    grep --quiet ': 100% coverage' build/eva.log &&
    grep --quiet '100% of the logical properties reached have been proven' build/eva.log
