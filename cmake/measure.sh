#!/bin/sh
# Compiler launcher: measure.sh LOG COMPILER ARGS... appends "seconds kilobytes object" to LOG.
log=$1
shift
object=
previous=
for argument in "$@"; do
    [ "$previous" = -o ] && object=$argument
    previous=$argument
done
exec /usr/bin/time -a -o "$log" -f "%e	%M	$object" "$@"
