#!/bin/sh
# Fails unless every line that a program prints on this machine is also printed on the AVR.
#
# Usage: same_on_avr.sh PROGRAM SIMULATOR...
here="$1"
shift
"$here" >"$here.here" || exit 1
"$@" >"$here.there" 2>&1
cat "$here.here"
while read -r line; do
    grep --quiet --fixed-strings -- "$line" "$here.there" || {
        printf 'the AVR does not print: %s\n' "$line"
        exit 1
    }
done <"$here.here"
grep --only-matching 'cycles.*[0-9]' "$here.there" || true
