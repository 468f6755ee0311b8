#!/usr/bin/env bash
# crash-safety probe: a stage writes half its output, sleeps, writes the rest. kill -9 the ENGINE mid-stage, then rerun.
B=${BENCH_HOME:-$PWD/work}; W=$B/crash; rm -rf $W; mkdir -p $W
STAGE='echo half > out.txt; sleep 6; echo whole >> out.txt; echo r >> runs.log'
killtree_engine() { kill -9 "$1" 2>/dev/null; }
echo "== dvc"; mkdir $W/dvc; cd $W/dvc; git init -q; $B/venv-dvc/bin/dvc init -q; $B/venv-dvc/bin/dvc config core.analytics false; printf "stages:\n  a:\n    cmd: '%s'\n    outs: [out.txt]\n  b:\n    cmd: cp out.txt b.txt\n    deps: [out.txt]\n    outs: [b.txt]\n" "$STAGE" > dvc.yaml
$B/venv-dvc/bin/dvc repro > 1.log 2>&1 & P=$!; for i in $(seq 100); do [ -f out.txt ] && break; sleep 0.1; done; sleep 1; kill -9 $P; echo "orphan still running: $(pgrep -f 'sleep 6' | wc -l)"; cat .dvc/tmp/rwlock 2>/dev/null | head -c 300; echo; $B/venv-dvc/bin/dvc repro > 2.log 2>&1; echo "rerun rc=$?"; tail -4 2.log; sleep 7; cat out.txt; cat runs.log | wc -l
echo "== snakemake"; mkdir $W/smk; cd $W/smk; printf "rule b:\n    input: 'out.txt'\n    output: 'b.txt'\n    shell: 'cp out.txt b.txt'\nrule a:\n    output: 'out.txt'\n    shell: '%s'\n" "$STAGE" > Snakefile
$B/venv-smk/bin/snakemake -c1 > 1.log 2>&1 & P=$!; for i in $(seq 100); do [ -f out.txt ] && break; sleep 0.1; done; sleep 1; kill -9 $P; echo "orphan: $(pgrep -f 'sleep 6' | wc -l)"; $B/venv-smk/bin/snakemake -c1 > 2.log 2>&1; echo "rerun rc=$?"; grep -E "Lock|locked|unlock|Incomplete" 2.log | head -3; $B/venv-smk/bin/snakemake --unlock > 3.log 2>&1; $B/venv-smk/bin/snakemake -c1 > 4.log 2>&1; echo "after --unlock rc=$?"; grep -vE "^$" 4.log | tail -5; sleep 6; $B/venv-smk/bin/snakemake -c1 --rerun-incomplete > 5.log 2>&1; echo "with --rerun-incomplete rc=$?"; cat out.txt runs.log
echo "== ninja"; mkdir $W/ninja; cd $W/ninja; printf "rule r\n  command = %s\nbuild out.txt: r\nrule c\n  command = cp out.txt b.txt\nbuild b.txt: c out.txt\n" "$STAGE" > build.ninja
ninja > 1.log 2>&1 & P=$!; for i in $(seq 100); do [ -f out.txt ] && break; sleep 0.1; done; sleep 1; kill -9 $P; ninja > 2.log 2>&1; echo "rerun rc=$?"; cat 2.log | tail -2; cat out.txt
echo "== make"; mkdir $W/make; cd $W/make; printf "b.txt: out.txt\n\tcp out.txt b.txt\nout.txt:\n\t%s\n" "$STAGE" > Makefile
make > 1.log 2>&1 & P=$!; for i in $(seq 100); do [ -f out.txt ] && break; sleep 0.1; done; sleep 1; kill -9 $P; pkill -P $P 2>/dev/null; make > 2.log 2>&1; echo "rerun rc=$?"; tail -2 2.log; echo "b.txt:"; cat b.txt
D=${DRIL_PIPE:-dril-pipe}
echo "== dril-pipe"; mkdir $W/dril; cd $W/dril; cat > p.yaml <<YAML
name: crash
stages:
  a: { kind: command, with: { shell: "echo half > {outputs.out}; echo begun >> $W/dril/seen.log; sleep 6.5; echo whole >> {outputs.out}; echo r >> $W/dril/runs.log", outputs: { out: out.txt } } }
  b: { kind: command, with: { shell: "cp {inputs.a} {outputs.out}", outputs: { out: { path: b.csv, type: table } } }, inputs: { a: a } }
YAML
$D run p.yaml > 1.log 2>&1 & P=$!; for i in $(seq 100); do [ -f seen.log ] && break; sleep 0.1; done; sleep 1; kill -9 $P; sleep 0.5; echo "orphan still running: $(pgrep -f "sleep 6[.]5" | wc -l)"; $D run p.yaml > 2.log 2>&1; echo "rerun rc=$?"; tail -2 2.log; echo "b:"; cat results/crash-default/b.*; echo "times that a ended: $(wc -l < runs.log)"
