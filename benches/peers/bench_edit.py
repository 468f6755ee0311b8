#!/usr/bin/env python3
"""What one edit costs: changes a parameter of the last block, so that a worker and the join after it run, and runs.

Wants the folder of a graph that bench_dag.py made for dril-pipe, and that was run. Prints processor time of the process
tree and wall time, median and least.
Usage: bench_edit.py N FOLDER PROGRAM...     # several programs in turns
"""
import os, random, re, statistics, subprocess, sys, time

count, folder, programs = int(sys.argv[1]), sys.argv[2], [os.path.abspath(program) for program in sys.argv[3:]]
os.chdir(folder)
text = open("pipe.yaml").read()
last = max(int(block) for block in re.findall(r"^  w(\d+)_0:", text, re.M))
parameter = re.compile(r"(^  w%d_0: .*\(\()\d+ %% \d+" % last, re.M)
found = {program: [] for program in programs}
for _ in range(count):
    for program in programs:
        # A remainder that no other worker has: else the join has seen all of its inputs before.
        text = parameter.sub(lambda match: f"{match[1]}{random.randrange(10**8)} % 999999937", text, count=1)
        open("pipe.yaml", "w").write(text)
        began = time.perf_counter()
        process = subprocess.Popen([program, "run", "pipe.yaml", "-q", "-j2"])
        _, status, usage = os.wait4(process.pid, 0)
        if status:
            sys.exit(f"{program} failed")
        found[program].append((usage.ru_utime + usage.ru_stime, time.perf_counter() - began))
for program, figures in found.items():
    cpu, wall = ([1e3 * figure[at] for figure in figures] for at in (0, 1))
    print(f"{program}: CPU {statistics.median(cpu):.1f} ms, least {min(cpu):.1f}; wall {statistics.median(wall):.1f} ms, least {min(wall):.1f}")
