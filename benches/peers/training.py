"""PyTorch beside dril-learn: the training steps of the CarRacing networks, measured in turns in the same minutes.

    python3 -m venv v && v/bin/pip install torch==2.13.0
    cargo bench -p dril-learn --bench training --no-run          # prints the path of OURS
    v/bin/python benches/peers/training.py OURS [rounds]

A round runs each case with PyTorch as `pip` installs it (eager, fused Adam, its own allocator) on two threads and on
one, and then two processes of ours with one thread each. Printed are medians over the rounds.
bf16 is left out where the processor has no instructions for it.

On an idle machine compare samples per second of the clock. On a busy one the clock measures the neighbours; then
compare samples per second of processor time, with PyTorch on ONE thread doubled: two threads of it are never more than
twice as fast as one, so our ratio to that is a lower bound, and threads that wait for each other do not enter.
"""

import json
import os
import statistics
import subprocess
import sys
import time

# Without these instructions 16-bit numbers are emulated, at a tenth of the speed.
SHORT = "avx512_bf16" in open("/proc/cpuinfo").read()

CASES = {
    # name: (our words, PyTorch's network, batch)
    "ppo, minibatch 64": (["ppo", "dril-cnn", "64"], "ppo", 64),
    "bc, batch 32": (["bc", "dril-cnn", "32"], "bc", 32),
}


def torch_step(kind, batch):
    """One training step of the network that `stages/learn/src/net` calls `dril-cnn`, in plain PyTorch."""
    import torch
    from torch import nn

    torch.manual_seed(1)

    class Agent(nn.Module):
        def __init__(self):
            super().__init__()
            relu, flat = nn.ReLU, nn.Flatten
            self.convolutions = nn.Sequential(
                nn.Conv2d(4, 32, 8, 4), relu(), nn.Conv2d(32, 64, 4, 2), relu(), nn.Conv2d(64, 64, 3, 1), relu(), flat()
            )
            self.actor = nn.Sequential(nn.Linear(3136, 512), relu(), nn.Linear(512, 512), relu(), nn.Linear(512, 4))
            if kind == "ppo":
                self.critic = nn.Sequential(nn.Linear(3136, 512), relu(), nn.Linear(512, 1))

        def forward(self, pixels):
            features = self.convolutions(pixels.float() / 255)
            alpha, beta = (nn.functional.softplus(self.actor(features)) + 1).chunk(2, 1)
            return alpha, beta, self.critic(features).squeeze(1) if kind == "ppo" else None

    agent = Agent()
    optimizer = torch.optim.Adam(agent.parameters(), lr=1e-5, eps=1e-5, fused=True)
    frames = torch.randint(0, 256, (2048, 4, 84, 84), dtype=torch.uint8)
    samples, advantages, returns = torch.full((2048, 2), 0.4), torch.randn(2048), torch.randn(2048)
    old_log_probs, old_values = torch.zeros(2048), torch.zeros(2048)

    def loss(rows):
        alpha, beta, values = agent(frames[rows])
        if kind == "bc":
            return ((2 * alpha / (alpha + beta) - 1).clamp(-1, 1) - 0.3).square().mean()
        distribution = torch.distributions.Beta(alpha, beta, validate_args=False)
        ratio = (distribution.log_prob(samples[rows]).sum(1) - old_log_probs[rows]).exp()
        policy = -torch.min(ratio * advantages[rows], ratio.clamp(0.9, 1.1) * advantages[rows]).mean()
        clipped = old_values[rows] + (values - old_values[rows]).clamp(-0.1, 0.1)
        errors = torch.max((values - returns[rows]).square(), (clipped - returns[rows]).square())
        return policy + 0.25 * errors.mean() - 0.01 * distribution.entropy().sum(1).mean()

    def step():
        optimizer.zero_grad(set_to_none=True)
        loss(torch.randint(0, 2048, (batch,))).backward()
        if kind == "ppo":
            nn.utils.clip_grad_norm_(agent.parameters(), 0.5)
        optimizer.step()

    return step


def torch_child(kind, batch, threads):
    import torch

    torch.set_num_threads(threads)
    step = torch_step(kind, batch)
    for _ in range(5):
        step()
    best = {"per_cpu_second": 0.0, "per_second": 0.0}
    for _ in range(5):
        clock, cpu, steps = time.perf_counter(), time.process_time(), 0
        while time.process_time() - cpu < 0.6 * threads:
            step()
            steps += 1
        done = steps * batch
        best["per_cpu_second"] = max(best["per_cpu_second"], done / (time.process_time() - cpu))
        best["per_second"] = max(best["per_second"], done / (time.perf_counter() - clock))
    print(json.dumps(best))


def peer(kind, batch, threads):
    command = [sys.executable, __file__, "--torch", kind, str(batch), str(threads)]
    environment = dict(os.environ, OMP_NUM_THREADS=str(threads))
    return json.loads(subprocess.run(command, env=environment, capture_output=True, check=True).stdout)


def ours(program, words, precision):
    """Two processes side by side, one thread each: their sum."""
    command = [program, "--json", precision, *words]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, text=True) for _ in range(2)]
    said = [json.loads(process.communicate()[0].splitlines()[0]) for process in both]
    return {key: sum(one[key] for one in said) for key in ("per_cpu_second", "per_second")}


def main():
    if sys.argv[1] == "--torch":
        return torch_child(sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
    program, rounds = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 3
    for name, (words, kind, batch) in CASES.items():
        seen = {}
        for _ in range(rounds):
            turns = {
                "PyTorch, 2 threads": lambda: peer(kind, batch, 2),
                "PyTorch, 1 thread": lambda: peer(kind, batch, 1),
                "ours fp32, 2 processes": lambda: ours(program, words, "fp32"),
                "ours bf16, 2 processes": lambda: ours(program, words, "bf16"),
            }
            if not SHORT:
                del turns["ours bf16, 2 processes"]
            for who, run in turns.items():
                seen.setdefault(who, []).append(run())
        median = lambda who, key: statistics.median(run[key] for run in seen[who])
        print(f"\n{name} (load {os.getloadavg()[0]:.1f})")
        print(f"{'':<26}{'/s of the clock':>16}{'ratio':>8}{'/s of 2 CPUs':>14}{'ratio':>8}")
        clock, cpu = median("PyTorch, 2 threads", "per_second"), 2 * median("PyTorch, 1 thread", "per_cpu_second")
        for who in seen:
            own, own_cpu = median(who, "per_second"), median(who, "per_cpu_second")
            if who == "PyTorch, 1 thread":
                own, own_cpu = 2 * own, 2 * own_cpu
                who += ", doubled"
            elif who == "PyTorch, 2 threads":
                own_cpu *= 2
            print(f"{who:<26}{own:>16.0f}{own / clock:>8.2f}{own_cpu:>14.0f}{own_cpu / cpu:>8.2f}")


main()
