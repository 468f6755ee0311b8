#!/usr/bin/env python3
"""Runs many stages on a simulated Slurm cluster and reports what the engine costs.

    tests/slurm/simulate.py PROGRAM [--stages 10000] [--nodes 200] [--slots 4] [--seconds 1] [--lost 20]

PROGRAM is `target/release/examples/fakes`. The engine calls the programs in `tests/slurm/simulated/` as `sbatch`, `squeue`,
`scontrol` and `scancel`; this script is the controller behind them and all nodes. A node does not start the stage's program: it
writes what the program would write. `--lost` jobs vanish with their node.
"""

import argparse
import heapq
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path


class Cluster:
    """The controller and its nodes."""

    def __init__(self, root, nodes, slots, seconds, lost):
        self.root, self.seconds, self.lost = root, seconds, lost
        self.free = [f"n{node}" for node in range(nodes) for _ in range(slots)]
        self.waiting, self.running, self.jobs, self.ended = [], [], {}, []
        self.written = 0.0
        for folder in ("new", "calls"):
            (root / folder).mkdir()
        (root / "next").write_text("1\n")
        (root / "squeue").write_text("")

    def step(self):
        """Accepts, starts and ends jobs, and publishes the list."""
        now = time.monotonic()
        for path in sorted((self.root / "new").glob("[0-9]*"), key=lambda path: int(path.name)):
            self.waiting.append((path.name, Path(path.read_text().strip())))
            self.jobs[path.name] = ("PENDING", "")
            path.unlink()
        while self.waiting and self.free:
            (job, folder), node = self.waiting.pop(0), self.free.pop()
            self.jobs[job] = ("RUNNING", node)
            heapq.heappush(self.running, (now + self.seconds, job, folder, node))
        while self.running and self.running[0][0] <= now:
            _, job, folder, node = heapq.heappop(self.running)
            self.free.append(node)
            self.ended.append((now, job))
            if self.lost > 0 and int(job) % 97 == 0:
                self.lost -= 1
                self.jobs[job] = ("NODE_FAIL", node)
            else:
                work(job, folder, node)
                self.jobs[job] = ("COMPLETED", node)
        # As with `MinJobAge=300`: ended jobs stay in the list for a while.
        while self.ended and self.ended[0][0] < now - 300:
            self.jobs.pop(self.ended.pop(0)[1], None)
        if now - self.written > 0.5:
            self.written = now
            lines = "".join(f"{job}|{state}|{node}\n" for job, (state, node) in self.jobs.items())
            (self.root / "squeue.new").write_text(lines)
            os.replace(self.root / "squeue.new", self.root / "squeue")


def work(job, folder, node):
    """Writes what a node writes: the outputs, how the stage ended, and the notice."""
    handoff = json.loads((folder / "handoff.json").read_text())
    for output in handoff["job"]["outputs"].values():
        Path(output["path"]).write_text(handoff["job"]["stage"])
    (folder / "claim").write_text(job)
    ended = {"version": 1, "job": job, "node": node, "how": "done", "messages": []}
    (folder / ".ended").write_text(json.dumps(ended))
    os.replace(folder / ".ended", folder / "ended.json")
    (folder.parent / "ended" / folder.name).write_text(job)


def usage(pid):
    """Seconds of processor time of the engine itself, and its largest memory in bytes."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    seconds = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    peak = next(line for line in Path(f"/proc/{pid}/status").read_text().splitlines() if line.startswith("VmHWM"))
    return seconds, int(peak.split()[1]) * 1024


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("program", type=Path)
    parser.add_argument("--stages", type=int, default=10_000)
    parser.add_argument("--nodes", type=int, default=200)
    parser.add_argument("--slots", type=int, default=4, help="jobs that a node runs at the same time")
    parser.add_argument("--seconds", type=float, default=1.0, help="how long a job runs")
    parser.add_argument("--lost", type=int, default=20, help="jobs that vanish with their node")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as folder:
        run(options, Path(folder))


def run(options, folder):
    words = ", ".join(str(number) for number in range(options.stages))
    (folder / "p.yaml").write_text(
        f"name: many\naxes: {{ word: [{words}] }}\nstages:\n"
        '  say: { kind: emit, matrix: [word], with: { text: "${word} " } }\n'
    )
    (folder / "dril-pipe.toml").write_text('[slurm]\nlocal = []\nmemory = "100M"\n')
    simulation = folder / "simulation"
    simulation.mkdir()
    cluster = Cluster(simulation, options.nodes, options.slots, options.seconds, options.lost)
    fakes = Path(__file__).resolve().parent / "simulated"
    environment = {"PATH": f"{fakes}:/usr/bin:/bin", "SIMULATION": str(simulation), "HOME": str(folder)}
    command = [options.program.resolve(), "run", "p.yaml", "--executor", "slurm", "--quiet"]
    began = time.monotonic()
    engine = subprocess.Popen(command, cwd=folder, env=environment)
    seconds, peak, busy = 0.0, 0, began + 5
    while engine.poll() is None:
        cluster.step()
        if time.monotonic() > busy:
            (simulation / "busy").touch()
            busy += 10
        try:
            seconds, peak = usage(engine.pid)
        except (OSError, StopIteration):
            pass
        time.sleep(0.005)
    took = time.monotonic() - began
    calls = {path.name: path.stat().st_size for path in sorted((simulation / "calls").iterdir())}
    records = sum(1 for _ in (folder / "cache/records-v1").glob("*/*.json"))
    print(f"{options.stages} stages on {options.nodes} nodes in {took:.0f} s, exit code {engine.returncode}")
    print(f"results: {records}")
    print(f"processor time of the engine: {seconds:.1f} s, {1000 * seconds / options.stages:.2f} ms for each stage")
    print(f"memory of the engine: {peak / 1e6:.0f} MB at most")
    for name, count in calls.items():
        print(f"{name}: {count} calls, {60 * count / took:.1f} per minute")
    if engine.returncode != 0 or records != options.stages or calls["sbatch"] < options.stages:
        sys.exit("FAILED")


if __name__ == "__main__":
    main()
