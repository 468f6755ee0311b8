#!/usr/bin/env python3
"""What the protection of inputs costs: one stage that reads a file of 2 GiB, and one that reads 10,000 files of 4 KiB.

usage: bench_inputs.py [--repeat N] [--gib N] [--files N] [--work DIR] NAME=PROGRAM [NAME=PROGRAM ...]

Each program has a store of its own with the inputs in it. In every round each program runs only the reading stage again
(`--force`), in turns; printed are medians of wall and CPU time (user + system of the whole process tree) and their ratio to
the first program's. Only figures of the same run can be compared.
"""
import argparse, os, pathlib, resource, shutil, statistics, subprocess, tempfile, time

PIPELINE = """name: inputs
stages:
  big: {{ kind: import, with: {{ path: big }} }}
  many: {{ kind: import, with: {{ path: many/ }} }}
  reads-big: {{ kind: command, with: {{ shell: "head -c 1 {{inputs.i}} > {{outputs.o}}", outputs: {{ o: o }} }}, inputs: {{ i: big }} }}
  reads-many: {{ kind: command, with: {{ shell: "ls {{inputs.i}}/ > {{outputs.o}}", outputs: {{ o: o }} }}, inputs: {{ i: many }} }}
"""


def run(program, work, cache, stage, force):
    command = [program, "run", "-q", "-j2", "p.yaml", stage, "--cache", cache] + (["--force", stage] if force else [])
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.monotonic()
    subprocess.run(command, cwd=work, check=True, stdin=subprocess.DEVNULL)
    wall, after = time.monotonic() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--gib", type=float, default=2.0)
    parser.add_argument("--files", type=int, default=10_000)
    parser.add_argument("--work")
    parser.add_argument("programs", nargs="+")
    args = parser.parse_args()
    work = pathlib.Path(tempfile.mkdtemp(prefix="dril-inputs-", dir=args.work))
    programs = [(name, os.path.abspath(path)) for name, path in (one.split("=", 1) for one in args.programs)]
    try:
        (work / "p.yaml").write_text(PIPELINE.format())
        block = os.urandom(1 << 20)
        with open(work / "big", "wb") as file:
            for number in range(int(args.gib * 1024)):
                file.write(number.to_bytes(8, "little") + block[8:])
        (work / "many").mkdir()
        for number in range(args.files):
            (work / "many" / f"{number:05}").write_bytes(number.to_bytes(8, "little") + block[: 4096 - 8])
        for stage in ["reads-big", "reads-many"]:
            taken = {name: [] for name, _ in programs}
            for turn in range(args.repeat + 1):
                for name, program in programs:
                    once = run(program, work, f"cache-{name}", stage, turn > 0)
                    if turn > 0:
                        taken[name].append(once)
            first = None
            for name, _ in programs:
                wall, cpu = (statistics.median(column) for column in zip(*taken[name]))
                first = first or (wall, cpu)
                print(f"{stage:<11} {name:<8} wall {wall:6.3f} s ({wall / first[0]:.2f} x)   CPU {cpu:6.3f} s ({cpu / first[1]:.2f} x)", flush=True)
    finally:
        shutil.rmtree(work, ignore_errors=True)


if __name__ == "__main__":
    main()
