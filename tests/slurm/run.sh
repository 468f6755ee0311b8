#!/usr/bin/env bash
# Tests `run --executor slurm` on a real Slurm: the one that is here, or one of a single node that this script starts.
# Ends with 0 and a line that says so where there is no Slurm. `tests/slurm/run.sh [NAME]...` runs only these tests.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
cd "$here/../.."

if ! command -v sbatch >/dev/null; then
    echo "SKIPPED: no Slurm here (apt-get install --no-install-recommends slurm-wlm slurmctld slurmd slurm-client munge)"
    exit 0
fi
features=${FEATURES:---no-default-features}
# shellcheck disable=SC2086
[ -n "${PROGRAM:-}" ] || cargo build --package dril-pipe $features --example fakes
program=$(realpath "${PROGRAM:-${CARGO_TARGET_DIR:-target}/debug/examples/fakes}")

root=$(mktemp -d /var/tmp/dril-slurm-XXXXXX)
started=
if ! timeout 5 sinfo >/dev/null 2>&1; then
    if [ "$(id -u)" != 0 ]; then
        echo "SKIPPED: Slurm is installed and not running, and only root can start it"
        exit 0
    fi
    "$here/up.sh" "$root/slurm" >/dev/null
    started=1
    export SLURM_CONF=$root/slurm/slurm.conf
fi
finish() {
    scancel --me 2>/dev/null || true
    [ -z "$started" ] || "$here/down.sh" "$root/slurm"
    # Daemons that are about to end may still write.
    rm -rf "$root" 2>/dev/null || { sleep 3; rm -rf "$root"; } || true
}
trap finish EXIT

fail() { echo "FAILED: $1" >&2; tail -n 30 ./*.out ./trace >&2 2>/dev/null || true; exit 1; }
# Waits at most a minute until a command succeeds.
until_true() { for _ in $(seq 600); do eval "$1" && return; sleep 0.1; done; fail "waited too long until $1"; }
running() { [ -n "$(squeue --noheader --me --states=RUNNING)" ]; }
no_jobs() { [ -z "$(squeue --noheader --me)" ]; }
begun() { [ ! -e trace ] && echo 0 || grep -c "^begin ${1:-}" trace || true; }
# Jobs of this test, also those that have ended, whose name begins so.
jobs() { squeue --noheader --me --states=all --format='%j %Z' | grep -c "^dril-$1.* $PWD/" || true; }
pilots() { jobs pilot; }
# Steps of the long stages; each is counted once where nothing was lost and nothing was done twice.
steps() { grep -c '^step' trace || true; }
slurm() { "$program" run p.yaml --executor slurm --checkpoint-every 0 "$@"; }
# Starts an engine in the background; a process of its own, so that signals reach it and no shell.
start() {
    "$program" run p.yaml --executor slurm --checkpoint-every 0 "$@" >run.out 2>&1 &
    engine=$!
}
same_as_local() {
    env -u DRIL_FAKES_TRACE "$program" run p.yaml --cache local-cache --out local >local.out 2>&1 || fail "the local run"
    diff -r --exclude=.dril-pipe.json --exclude=report.html local results/chain-default || fail "other bytes than locally"
}

# A folder of its own for a test: two chains of a long stage and a table of both.
place() {
    mkdir -p "$root/$1" && cd "$root/$1"
    export DRIL_FAKES_TRACE=$PWD/trace
    cat >p.yaml <<YAML
name: chain
axes: { word: [one, two] }
stages:
  say: { kind: emit, matrix: [word], with: { text: "\${word} " } }
  count: { kind: count, matrix: [word], with: { to: ${2:-20}, step_millis: 100 }, inputs: { start: say } }
  gather: { kind: concat, inputs: { parts: count.count } }
YAML
    cat >dril-pipe.toml <<TOML
[slurm]
local = ["concat"]
memory = "100M"
${3:-}
TOML
}

test_the_same_bytes_as_locally() {
    place bytes 3
    slurm >run.out 2>&1 || fail "the run"
    same_as_local
}

test_a_cancelled_job_fails_its_stage_and_the_next_run_goes_on() {
    place cancel
    start
    until_true running; sleep 1
    scancel --me
    wait "$engine" && fail "a run whose jobs were cancelled succeeded"
    grep -q "was cancelled" run.out || fail "it does not say that its job was cancelled"
    slurm >again.out 2>&1 || fail "the next run"
    same_as_local
}

requeue() {
    place "$1" 40 "${2:-}"
    start
    until_true '[ "$(begun count)" -ge 2 ]'; sleep 1
    squeue --noheader --me --states=RUNNING --format=%i | while read -r job; do scontrol requeue "$job"; done
    # Slurm keeps a requeued job back for a while.
    wait "$engine" || fail "the run"
    [ "$(begun count)" = 4 ] || fail "$(begun count) long stages begun, expected each of both twice"
    [ "$(steps)" -lt 85 ] || fail "$(steps) steps, expected about 80: what was saved is not done again"
    same_as_local
}

test_a_requeued_job_goes_on_from_its_checkpoint() { requeue requeue; }
test_a_requeued_pilot_hands_its_stage_to_another() { requeue pilot-requeue "pilots = 2"; }

killed() {
    place "$1" 60 "${2:-}"
    start
    until_true '[ "$(begun)" -ge 4 ]'
    kill -9 "$engine"; wait "$engine" || true
    running || fail "the jobs died with their engine"
    slurm >again.out 2>&1 || fail "the next run"
    [ "$(begun)" = 5 ] || fail "$(begun) stages begun, expected 5: none of them twice"
    same_as_local
}

test_a_new_engine_finds_the_jobs_of_a_killed_one() { killed killed; }
test_a_new_engine_finds_the_pilots_of_a_killed_one() {
    killed pilot-killed "pilots = 2"
    [ "$(pilots)" = 2 ] || fail "$(pilots) pilots, expected the 2 of the killed engine"
    until_true no_jobs
}

interrupt() {
    place "$1" 40 "${2:-}"
    start
    until_true '[ "$(begun count)" -ge 2 ]'; sleep 1.5
    kill -TERM "$engine"
    code=0; wait "$engine" || code=$?
    [ "$code" = 130 ] || fail "exit code $code, expected 130"
    until_true no_jobs
    slurm >again.out 2>&1 || fail "the next run"
    [ "$(begun count)" = 4 ] || fail "$(begun count) long stages begun, expected each of both twice"
    [ "$(steps)" = 80 ] || fail "$(steps) steps, expected 80: none of them twice"
    same_as_local
}

test_an_interrupt_leaves_no_jobs_and_loses_no_work() { interrupt interrupt; }
test_an_interrupt_leaves_no_pilots_and_loses_no_work() { interrupt pilot-interrupt "pilots = 2"; }

detach() {
    place "$1" 30 "${2:-}"
    start --detach
    until_true '[ "$(begun)" -ge 4 ]'
    kill -TERM "$engine"; wait "$engine" || true
    running || fail "the jobs were cancelled"
    until_true no_jobs
    slurm >again.out 2>&1 || fail "the next run"
    [ "$(begun)" = 5 ] || fail "$(begun) stages begun, expected 5: none of them twice"
    same_as_local
}

test_detached_jobs_go_on_without_an_engine() { detach detach; }
test_detached_pilots_go_on_without_an_engine() { detach pilot-detach $'pilots = 2\npilot_idle = "2s"'; }

# Another stage after each long one: its job is submitted while something is wrong.
longer_chains() {
    sed -i 's/^  gather:/  next: { kind: emit, matrix: [word], with: { text: x }, inputs: { after: count.count } }\n  gather:/' p.yaml
}

test_a_node_that_is_drained_finishes_its_jobs_and_the_others_wait() {
    [ -n "$started" ] || { echo "  skipped: not our own Slurm"; return 0; }
    place drain 30
    longer_chains
    start
    until_true '[ "$(begun count)" -ge 1 ]'
    scontrol update NodeName="$(hostname -s)" State=DRAIN Reason=test
    sleep 15
    scontrol update NodeName="$(hostname -s)" State=RESUME
    wait "$engine" || fail "the run"
    [ "$(begun)" = 7 ] || fail "$(begun) stages begun, expected 7: none of them twice"
    [ "$(steps)" = 60 ] || fail "$(steps) steps, expected 60: none of them twice"
    same_as_local
}

test_a_controller_that_is_away_for_a_minute_costs_time_only() {
    [ -n "$started" ] || { echo "  skipped: not our own Slurm"; return 0; }
    place controller 30
    longer_chains
    start
    until_true running
    kill "$(cat "$root/slurm/run/slurmctld.pid")"
    sleep 60
    slurmctld -f "$SLURM_CONF"
    wait "$engine" || fail "the run"
    [ "$(begun)" = 7 ] || fail "$(begun) stages begun, expected 7: none of them twice"
    same_as_local
}

limit() {
    # A job of a minute that is asked to stop 50 seconds before its end.
    place "$1" 1000 $'time = "1m"\nsignal = "50s"\n'"${2:-}"
    slurm >run.out 2>&1 || fail "the run"
    [ "$(begun count)" -ge 6 ] || fail "$(begun count) jobs for the two stages, expected three or more for each"
    [ "$(steps)" = 2000 ] || fail "$(steps) steps, expected 2000: none of them twice"
    same_as_local
}

test_a_stage_goes_on_in_job_after_job() { limit limit; }
test_a_stage_goes_on_in_pilot_after_pilot() { limit pilot-limit "pilots = 2"; }

# The processes of a pilot in this test's folder, without its stage.
pilot_processes() {
    local line
    for line in /proc/[0-9]*/cmdline; do
        tr '\0' ' ' <"$line" 2>/dev/null | grep -q "__pilot $PWD/" && echo "${line//[!0-9]/}" || true
    done
}
test_a_stage_whose_pilot_is_killed_goes_on_in_a_job_of_its_own() {
    place pilot-dies 60 "pilots = 2"
    start
    until_true '[ "$(begun count)" -ge 2 ]'; sleep 1
    kill -9 "$(pilot_processes | head -n 1)"
    wait "$engine" || fail "the run"
    [ "$(begun count)" = 3 ] || fail "$(begun count) long stages begun, expected one of both twice"
    [ "$(steps)" -le 122 ] || fail "$(steps) steps, expected about 120: what was saved is not done again"
    same_as_local
}

test_a_stage_that_needs_more_than_a_pilot_has_a_job_of_its_own() {
    place pilot-small 3 $'pilots = 1\npilot_idle = "1s"'
    sed -i 's/{ kind: count,/{ kind: count, memory: 200M,/' p.yaml
    slurm >run.out 2>&1 || fail "the run"
    [ "$(pilots)" = 1 ] && [ "$(jobs "[0-9a-f]")" = 2 ] || fail "$(pilots) pilots and $(jobs "[0-9a-f]") jobs"
    same_as_local
}

# Table 22 at its smallest size, with the full program (`FULL`), in pilots and in jobs.
test_the_smoke_profile_of_the_thesis_has_the_same_bytes_as_locally() {
    local full=${FULL:-$here/../../${CARGO_TARGET_DIR:-target}/debug/dril-pipe} pipelines=$here/../../pipelines
    [ -x "$full" ] && [ -x "${full%/*}/dril-pipe-learn" ] || { echo "  skipped: there is no $full with dril-pipe-learn"; return 0; }
    full=$(realpath "$full")
    mkdir -p "$root/thesis" && cd "$root/thesis"
    cp -r "$pipelines" pipelines
    printf '[slurm]\nmemory = "2G"\npilots = 1\n[slurm.kinds.ppo]\npilot = false\n[slurm.kinds.dril]\npilot = false\n' \
        >pipelines/dril-pipe.toml
    "$full" run pipelines/thesis.yaml --profile smoke --executor slurm --cache on-slurm --out tables >run.out 2>&1 ||
        fail "the run on Slurm"
    "$full" run pipelines/thesis.yaml --profile smoke --cache here --out local >local.out 2>&1 || fail "the local run"
    diff -r --exclude=.dril-pipe.json --exclude=report.html local tables || fail "other tables than locally"
    # Records are named by keys, which have the digests of inputs in them, and blobs by the digests of their content.
    contents() { (cd "$1" && find records-v1 blobs-v1 -type f | sort); }
    diff <(contents here) <(contents on-slurm) || fail "other artifacts than locally"
    echo "  $(contents here | grep -c ^records) records and $(contents here | grep -c ^blobs) blobs are the same; $(grep ^done run.out)"
}

test_an_error_names_its_node_and_job() {
    place error 3
    if slurm --set count.mishap=fail --set count.at=2 >run.out 2>&1; then fail "the run of failing stages succeeded"; fi
    grep -q "on node \`$(hostname -s)\` (Slurm job [0-9]*)" run.out || fail "the error does not name its node"
    printf '[slurm]\nlocal = []\npartition = "nowhere"\n' >dril-pipe.toml
    if slurm >refused.out 2>&1; then fail "a partition that is not there was taken"; fi
    grep -q "Slurm refuses its job: .*[Ii]nvalid partition" refused.out || fail "the refusal is not reported"
}


# COUNT stages of a few milliseconds.
small_stages() {
    mkdir -p "$root/$1" && cd "$root/$1"
    export DRIL_FAKES_TRACE=$PWD/trace
    cat >p.yaml <<YAML
name: small
axes: { word: [$(seq -s, "$2")] }
stages:
  say: { kind: emit, matrix: [word], with: { text: "\${word} " } }
  gather: { kind: concat, inputs: { parts: say.text } }
YAML
    printf '[slurm]\nlocal = ["concat"]\nmemory = "100M"\npilots = 2\n%s\n' "${3:-}" >dril-pipe.toml
}

# DRIL_STAGES=1000 for the figures of docs/performance.md.
test_many_small_stages_run_in_two_pilots() {
    local count=${DRIL_STAGES:-200} began millis
    small_stages pilots "$count"
    began=$(date +%s%N)
    slurm >run.out 2>&1 || fail "the run"
    millis=$(( ($(date +%s%N) - began) / 1000000 ))
    [ "$(begun emit)" = "$count" ] || fail "$(begun emit) stages begun, expected $count: none of them twice"
    [ "$(pilots)" = 2 ] || fail "$(pilots) pilots, expected 2"
    [ "$(jobs "[0-9a-f]")" = 0 ] || fail "a stage had a job of its own"
    until_true no_jobs
    [ "$(find cache/pilots-v1 -mindepth 1 -maxdepth 1 -not -name 'queue-*')" = "" ] || fail "a pilot left its folder"
    began=$(date +%s%N)
    env -u DRIL_FAKES_TRACE "$program" run p.yaml --cache local-cache --out local >local.out 2>&1 || fail "the local run"
    echo "  $count stages: $millis ms in two pilots, $(( ($(date +%s%N) - began) / 1000000 )) ms locally"
    diff -r --exclude=.dril-pipe.json --exclude=report.html local results/small-default || fail "other bytes than locally"
}

tests=("$@")
[ "$#" -gt 0 ] || mapfile -t tests < <(declare -F | sed -n 's/^declare -f \(test_.*\)$/\1/p')
for name in "${tests[@]}"; do
    began=$SECONDS
    (unset DRIL_FAKES_TRACE; "test_${name#test_}") || { echo "FAILED ${name#test_}"; exit 1; }
    echo "ok ${name#test_} ($((SECONDS - began)) s)"
done
