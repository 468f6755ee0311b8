#!/usr/bin/env python3
"""Synthetic DAG benchmark for pipeline engines.

DAG: B blocks in a chain; each block fans out from the previous join to W workers and fans in to one join.
     N stages = B * (W + 1).  W=9 by default: N=100 -> 10 blocks, N=1000 -> 100 blocks.
  worker(b,i): reads join(b-1) (or src.txt for b=0), writes "<first line> <param % 10>"
  join(b):     cat of the W workers | cksum
Scenarios: full (cold), noop (nothing changed), leaf (one param of the LAST block changed: 2 stages truly needed),
           cutoff (a param of the FIRST block changed by +10: worker reruns, its output is byte-identical,
                   so an engine with early cutoff runs 1 stage; one without reruns every stage downstream),
           edit1 (rewrite first-block param by +1: all downstream needed; only for --deep)
Usage: bench_dag.py --engines dvc,snakemake,ninja,make,doit,turbo,moon,bare --n 100 --repeat 3 --out results.jsonl
Engine binaries are looked up in $PATH or by --bin name=path.
"""
import argparse, json, os, re, shutil, statistics, subprocess, sys, time, resource, pathlib

HERE = pathlib.Path(os.environ.get("BENCH_HOME", pathlib.Path(__file__).resolve().parent / "work"))
BINS = {
    "dvc": HERE / "venv-dvc/bin/dvc",
    "snakemake": HERE / "venv-smk/bin/snakemake",
    "ninja": "/usr/bin/ninja",
    "make": "/usr/bin/make",
    "doit": HERE / "venv-doit/bin/doit",
    "redun": HERE / "venv-redun/bin/redun",
    "turbo": HERE / "npm/node_modules/.bin/turbo",
    "moon": HERE / "npm/node_modules/.bin/moon",
    "dril": "dril-pipe",
}

def timed(cmd, cwd, env=None, log=None):
    """wall s, peak RSS MiB of the largest single process in the tree (GNU time's wait4 figure), cpu s of the tree, rc"""
    e = dict(os.environ); e.update(env or {}); tf = f"/tmp/.bench_time.{os.getpid()}"
    t = time.perf_counter()
    with open(log or os.devnull, "wb") as lf:
        rc = subprocess.call(["/usr/bin/time", "-q", "-o", tf, "-f", "%M %U %S"] + [str(c) for c in cmd], cwd=cwd, stdout=lf, stderr=subprocess.STDOUT, env=e)
    w = time.perf_counter() - t
    m, u, s_ = open(tf).read().split()[-3:]
    return w, float(m) / 1024, float(u) + float(s_), rc

class Dag:
    def __init__(self, n, w=9):
        self.w = w; self.b = max(1, n // (w + 1)); self.n = self.b * (w + 1)
        self.p = {(b, i): (b * w + i) % 10 + 1 for b in range(self.b) for i in range(w)}
    def src(self, b): return "src.txt" if b == 0 else f"out/j{b-1}.txt"
    def wout(self, b, i): return f"out/w{b}_{i}.txt"
    def jout(self, b): return f"out/j{b}.txt"
    # commands: p is spliced in as text
    def wcmd(self, b, i, p=None, src=None, out=None):
        p = self.p[b, i] if p is None else p
        return f"read x < {src or self.src(b)}; echo $x $(({p} % 10)) > {out or self.wout(b,i)}; echo r >> {self.log}"
    def jcmd(self, b, ins=None, out=None):
        ins = ins or " ".join(self.wout(b, i) for i in range(self.w))
        return f"cat {ins} | cksum > {out or self.jout(b)}; echo r >> {self.log}"

class Engine:
    env = {}
    def __init__(self, d, root): self.d, self.root = d, root; d.log = str(root.parent / (root.name + ".runs"))
    def runs(self):
        try: n = sum(1 for _ in open(self.d.log))
        except FileNotFoundError: n = 0
        open(self.d.log, "w").close(); return n
    def setup(self):
        shutil.rmtree(self.root, ignore_errors=True); self.root.mkdir(parents=True)
        (self.root / "src.txt").write_text("1 seed\n"); (self.root / "out").mkdir(); open(self.d.log, "w").close(); self.gen()
    def touch(self, key, delta): self.d.p[key] += delta; self.params()

class Bare(Engine):
    def gen(self): pass
    def params(self): pass
    def cmd(self):
        lines = []
        for b in range(self.d.b):
            lines += [self.d.wcmd(b, i) for i in range(self.d.w)] + [self.d.jcmd(b)]
        (self.root / "cmds.txt").write_text("\0".join(lines))
        return ["sh", "-c", "xargs -0 -n1 -P1 sh -c < cmds.txt"]

class Ninja(Engine):
    def gen(self): self.params()
    def params(self):
        d = self.d; L = ["rule r\n  command = $c\n  restat = 1\n"]
        for b in range(d.b):
            for i in range(d.w):
                L.append(f"build {d.wout(b,i)}: r {d.src(b)}\n  c = {d.wcmd(b,i).replace('$','$$')}\n")
            L.append(f"build {d.jout(b)}: r {' '.join(d.wout(b,i) for i in range(d.w))}\n  c = {d.jcmd(b).replace('$','$$')}\n")
        (self.root / "build.ninja").write_text("".join(L))
    def cmd(self): return [str(BINS["ninja"]), "-j2", "--quiet"]

class Make(Engine):
    def gen(self): self.params()
    def params(self):
        d = self.d; L = [f"all: {d.jout(d.b-1)}\n"]
        for b in range(d.b):
            for i in range(d.w):
                # a param file per stage is the usual make idiom for param tracking
                pf = self.root / f"out/p{b}_{i}"; t = str(d.p[b, i])
                if not pf.exists() or pf.read_text() != t: pf.write_text(t)
                L.append(f"{d.wout(b,i)}: {d.src(b)} out/p{b}_{i}\n\t@{d.wcmd(b,i).replace('$','$$')}\n")
            L.append(f"{d.jout(b)}: {' '.join(d.wout(b,i) for i in range(d.w))}\n\t@{d.jcmd(b).replace('$','$$')}\n")
        (self.root / "Makefile").write_text("".join(L))
    def cmd(self): return [str(BINS["make"]), "-j2", "-s"]

class Dvc(Engine):
    env = {"DVC_NO_ANALYTICS": "1", "DVC_STUDIO_OFFLINE": "1"}
    def gen(self):
        d = self.d; dv = str(BINS["dvc"])
        run = lambda *a: subprocess.run(a, cwd=self.root, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        run("git", "init", "-q"); run(dv, "init", "-q"); run(dv, "config", "core.analytics", "false"); run(dv, "config", "core.check_update", "false")
        shutil.rmtree(self.root / "out"); (self.root / "out").mkdir()
        L = ["stages:\n"]
        for b in range(d.b):
            for i in range(d.w):
                L.append(f"  w{b}_{i}:\n    cmd: 'read x < {d.src(b)}; echo $x $((${{p{b}_{i}}} % 10)) > {d.wout(b,i)}; echo r >> {d.log}'\n    deps: [{d.src(b)}]\n    params: [p{b}_{i}]\n    outs: [{d.wout(b,i)}]\n")
            L.append(f"  j{b}:\n    cmd: '{d.jcmd(b)}'\n    deps: [{', '.join(d.wout(b,i) for i in range(d.w))}]\n    outs: [{d.jout(b)}]\n")
        (self.root / "dvc.yaml").write_text("".join(L)); self.params()
    def params(self): (self.root / "params.yaml").write_text("".join(f"p{b}_{i}: {v}\n" for (b, i), v in self.d.p.items()))
    def cmd(self): return [str(BINS["dvc"]), "repro", "-q"]

class Smk(Engine):
    def gen(self):
        d = self.d
        (self.root / "Snakefile").write_text(f'''
configfile: "config.yaml"
W={d.w}
rule all:
    input: "{d.jout(d.b-1)}"
rule worker:
    input: lambda w: "src.txt" if int(w.b) == 0 else f"out/j{{int(w.b)-1}}.txt"
    output: "out/w{{b}}_{{i}}.txt"
    wildcard_constraints: b=r"\\d+", i=r"\\d+"
    params: p=lambda w: config[f"p{{w.b}}_{{w.i}}"]
    shell: "read x < {{input}}; echo $x $(({{params.p}} % 10)) > {{output}}; echo r >> {d.log}"
rule join:
    input: expand("out/w{{{{b}}}}_{{i}}.txt", i=range(W))
    output: "out/j{{b}}.txt"
    wildcard_constraints: b=r"\\d+"
    shell: "cat {{input}} | cksum > {{output}}; echo r >> {d.log}"
'''); self.params()
    def params(self): (self.root / "config.yaml").write_text("".join(f"p{b}_{i}: {v}\n" for (b, i), v in self.d.p.items()))
    def cmd(self): return [str(BINS["snakemake"]), "--cores", "2", "-q", "all"]

class Doit(Engine):
    def gen(self):
        d = self.d
        (self.root / "dodo.py").write_text(f'''
import json
from doit.tools import config_changed
P = json.load(open("params.json"))
DOIT_CONFIG = {{"verbosity": 0, "reporter": "error-only"}}
def task_w():
    for b in range({d.b}):
        for i in range({d.w}):
            src = "src.txt" if b == 0 else f"out/j{{b-1}}.txt"
            p = P[f"{{b}}_{{i}}"]
            yield dict(name=f"{{b}}_{{i}}", file_dep=[src], targets=[f"out/w{{b}}_{{i}}.txt"], uptodate=[config_changed(str(p))],
                actions=[f"read x < {{src}}; echo $x $(({{p}} %% 10)) > out/w{{b}}_{{i}}.txt; echo r >> {d.log}"])
def task_j():
    for b in range({d.b}):
        ins = [f"out/w{{b}}_{{i}}.txt" for i in range({d.w})]
        yield dict(name=str(b), file_dep=ins, targets=[f"out/j{{b}}.txt"], actions=["cat " + " ".join(ins) + f" | cksum > out/j{{b}}.txt; echo r >> {d.log}"])
'''); self.params()
    def params(self): (self.root / "params.json").write_text(json.dumps({f"{b}_{i}": v for (b, i), v in self.d.p.items()}))
    def cmd(self): return [str(BINS["doit"]), "-n", "2"]

def pkgs(d):
    for b in range(d.b):
        for i in range(d.w): yield f"w{b}_{i}", ([] if b == 0 else [f"j{b-1}"]), (b, i)
        yield f"j{b}", [f"w{b}_{i}" for i in range(d.w)], None

class Turbo(Engine):
    env = {"TURBO_TELEMETRY_DISABLED": "1", "DO_NOT_TRACK": "1", "TURBO_NO_UPDATE_NOTIFIER": "1"}
    def gen(self):
        d = self.d; r = self.root
        (r / "package.json").write_text(json.dumps({"name": "root", "private": True, "workspaces": ["pk/*"], "packageManager": "npm@11.19.1"}))
        lock = {"name": "root", "lockfileVersion": 3, "requires": True, "packages": {"": {"name": "root", "workspaces": ["pk/*"]}}}
        (r / "turbo.json").write_text(json.dumps({"tasks": {"build": {"dependsOn": ["^build"], "outputs": ["out.txt"], "inputs": ["package.json", "param.txt"]}}}))
        (r / ".gitignore").write_text("out.txt\n.turbo\nnode_modules\n")
        for name, deps, key in pkgs(d):
            p = r / "pk" / name; p.mkdir(parents=True)
            if key:
                src = f"../{deps[0]}/out.txt" if deps else "../../src.txt"
                c = f"read p < param.txt; read x < {src}; echo $x $((p % 10)) > out.txt; echo r >> {d.log}"
            else: c = "cat " + " ".join(f"../{x}/out.txt" for x in deps) + f" | cksum > out.txt; echo r >> {d.log}"
            (p / "package.json").write_text(json.dumps({"name": name, "version": "1.0.0", "scripts": {"build": c}, "dependencies": {x: "*" for x in deps}}))
            lock["packages"][f"pk/{name}"] = {"name": name, "version": "1.0.0", "dependencies": {x: "*" for x in deps}}
            lock["packages"][f"node_modules/{name}"] = {"resolved": f"pk/{name}", "link": True}
        (r / "package-lock.json").write_text(json.dumps(lock)); self.params()
        subprocess.run("git init -q; git add -A; git -c user.email=a@b -c user.name=a commit -qm x", shell=True, cwd=r, check=True)
    def params(self):
        for (b, i), v in self.d.p.items():
            f = self.root / f"pk/w{b}_{i}/param.txt"; t = f"{v}\n"
            if not f.exists() or f.read_text() != t: f.write_text(t)
    def cmd(self): return [str(BINS["turbo"]), "run", "build", "--output-logs=none", "--concurrency=2", "--ui=stream"]

class Moon(Engine):
    env = {"MOON_TELEMETRY": "false", "PROTO_OFFLINE": "1", "MOON_CONCURRENCY": "2", "CI": ""}
    def gen(self):
        d = self.d; r = self.root
        (r / ".moon").mkdir()
        (r / ".moon/workspace.yml").write_text("projects:\n  globs:\n    - 'pk/*'\nvcs:\n  defaultBranch: 'master'\ntelemetry: false\n")
        (r / ".gitignore").write_text("out.txt\n.moon/cache\n.moon/docker\n")
        for name, deps, key in pkgs(d):
            p = r / "pk" / name; p.mkdir(parents=True)
            if key:
                src = f"../{deps[0]}/out.txt" if deps else "../../src.txt"
                c = f"read p < param.txt; read x < {src}; echo $x $((p % 10)) > out.txt; echo r >> {d.log}"
            else: c = "cat " + " ".join(f"../{x}/out.txt" for x in deps) + f" | cksum > out.txt; echo r >> {d.log}"
            (p / "do.sh").write_text(c + "\n")
            (p / "moon.yml").write_text("dependsOn: [" + ", ".join(deps) + "]\ntasks:\n  build:\n    command: 'sh do.sh'\n    deps: ['^:build']\n    inputs: ['param.txt', 'do.sh']\n    outputs: ['out.txt']\n")
        self.params()
        subprocess.run("git init -q; git add -A; git -c user.email=a@b -c user.name=a commit -qm x", shell=True, cwd=r, check=True)
    def params(self): Turbo.params(self)
    def cmd(self): return [str(BINS["moon"]), "run", ":build", "--log", "error", "--concurrency", "2"]

class Dril(Engine):
    """dril-pipe: one stage of kind `command` for each worker and join. Values are written into the commands, as for ninja."""
    def gen(self): self.params()
    def params(self):
        d = self.d; L = ["name: bench\nstages:\n"]
        for b in range(d.b):
            src = "{ file: src.txt }" if b == 0 else f"j{b-1}"
            for i in range(d.w):
                c = d.wcmd(b, i, src="{inputs.src}", out="{outputs.out}").replace("$", "$$")
                L.append(f"  w{b}_{i}: {{ kind: command, with: {{ shell: '{c}', outputs: {{ out: out.txt }} }}, inputs: {{ src: {src} }} }}\n")
            names = [f"w{b}_{i}" for i in range(d.w)]
            c = d.jcmd(b, ins=" ".join(f"{{inputs.{name}}}" for name in names), out="{outputs.out}")
            wires = ", ".join(f"{name}: {name}" for name in names)
            L.append(f"  j{b}: {{ kind: command, with: {{ shell: '{c}', outputs: {{ out: out.txt }} }}, inputs: {{ {wires} }} }}\n")
        (self.root / "pipe.yaml").write_text("".join(L))
    def cmd(self): return [str(BINS["dril"]), "run", "pipe.yaml", "-j2", "-q"]

ENG = {"bare": Bare, "ninja": Ninja, "make": Make, "dvc": Dvc, "snakemake": Smk, "doit": Doit, "turbo": Turbo, "moon": Moon, "dril": Dril}

def main():
    ap = argparse.ArgumentParser(); ap.add_argument("--engines", default="ninja,make,dvc,snakemake"); ap.add_argument("--n", type=int, default=100)
    ap.add_argument("--w", type=int, default=9); ap.add_argument("--repeat", type=int, default=3); ap.add_argument("--work", default=str(HERE / "bench"))
    ap.add_argument("--out", default=str(HERE / "results_dag.jsonl")); ap.add_argument("--scenarios", default="full,noop,leaf,cutoff"); ap.add_argument("--bin", action="append", default=[])
    a = ap.parse_args()
    for kv in a.bin: k, v = kv.split("=", 1); BINS[k] = v
    for name in a.engines.split(","):
        d = Dag(a.n, a.w); e = ENG[name](d, pathlib.Path(a.work) / f"{name}-{a.n}"); e.setup(); res = {"engine": name, "n": d.n, "w": d.w}
        def go(tag, rep, before=None):
            ts, ms, cs, rs = [], [], [], []
            for _ in range(rep):
                if before: before()
                e.runs(); t, m, c, rc = timed(e.cmd(), e.root, e.env, log=f"{a.work}/{name}-{a.n}-{tag}.log")
                if rc: print(name, tag, "rc", rc, file=sys.stderr)
                ts.append(t); ms.append(m); cs.append(c); rs.append(e.runs())
            res[tag] = {"wall_s": round(statistics.median(ts), 4), "all": [round(x, 4) for x in ts], "cpu_s": round(statistics.median(cs), 3), "rss_mib": round(max(ms), 1), "stages_run": rs[-1]}
            print(name, d.n, tag, json.dumps(res[tag]), flush=True)
        sc = a.scenarios.split(",")
        if "full" in sc: go("full", 1)
        if name != "bare":
            if "noop" in sc: go("noop", a.repeat)
            if "leaf" in sc: go("leaf", a.repeat, lambda: e.touch((d.b - 1, 0), 1))
            if "cutoff" in sc: go("cutoff", 1, lambda: e.touch((0, 0), 10))
            if "noop2" in sc: go("noop2", 1)
        pathlib.Path(a.out).parent.mkdir(parents=True, exist_ok=True)
    with open(a.out, "a") as f: f.write(json.dumps(res) + "\n")
main()
