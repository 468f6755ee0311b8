#!/usr/bin/env bash
# Stops what `up.sh` started: `tests/slurm/down.sh [FOLDER]`.
folder=$(realpath -m "${1:-.slurm}")
for daemon in slurmd slurmctld; do
    [ -f "$folder/run/$daemon.pid" ] && kill "$(cat "$folder/run/$daemon.pid")"
done
[ -f /run/munge/munged.pid ] && kill "$(cat /run/munge/munged.pid)"
exit 0
