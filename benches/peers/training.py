"""PyTorch beside dril-learn: the training steps of the CarRacing networks, measured in turns in the same minutes.

    python3 -m venv v && v/bin/pip install torch==2.13.0
    cargo bench -p dril-learn --bench training --no-run          # prints the path of OURS
    v/bin/python benches/peers/training.py OURS [rounds]

A round runs each case with PyTorch as `pip` installs it (eager, fused Adam, its own allocator) on one thread, and then
with ours on each path of its kernels. Printed are medians over the rounds of samples per second of processor time, so
that work beside it does not enter. (Two processes on one thread each lose nothing against one thread, and two threads of
PyTorch are never more than twice as fast as one.)
"""

import json
import os
import statistics
import subprocess
import sys
import time

CASES = {
    # name: (our words, PyTorch's network, batch)
    "ppo, minibatch 64": (["ppo", "dril-cnn", "64"], "ppo", 64),
    "bc, batch 32": (["bc", "dril-cnn", "32"], "bc", 32),
}


def torch_step(kind, batch):
    """One training step of the network that `stages/learn/src/nn` calls `dril-cnn`, in plain PyTorch."""
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


def torch_child(kind, batch):
    import torch

    torch.set_num_threads(1)
    step = torch_step(kind, batch)
    for _ in range(5):
        step()
    best = 0.0
    for _ in range(5):
        cpu, steps = time.process_time(), 0
        while time.process_time() - cpu < 0.6:
            step()
            steps += 1
        best = max(best, steps * batch / (time.process_time() - cpu))
    print(best)


def peer(kind, batch):
    command = [sys.executable, __file__, "--torch", kind, str(batch)]
    environment = dict(os.environ, OMP_NUM_THREADS="1")
    return float(subprocess.run(command, env=environment, capture_output=True, check=True).stdout)


def ours(program, words):
    """Samples per second of processor time, by path."""
    said = subprocess.run([program, "--json", *words], capture_output=True, check=True, text=True).stdout
    return {line["path"]: line["per_cpu_second"] for line in map(json.loads, said.splitlines())}


def main():
    if sys.argv[1] == "--torch":
        return torch_child(sys.argv[2], int(sys.argv[3]))
    program, rounds = sys.argv[1], int(sys.argv[2]) if len(sys.argv) > 2 else 3
    for name, (words, kind, batch) in CASES.items():
        seen = {}
        for _ in range(rounds):
            seen.setdefault("PyTorch", []).append(peer(kind, batch))
            for path, rate in ours(program, words).items():
                seen.setdefault(f"ours, {path}", []).append(rate)
        median = {who: statistics.median(rates) for who, rates in seen.items()}
        print(f"\n{name} (load {os.getloadavg()[0]:.1f})")
        for who, rate in median.items():
            print(f"{who:<16}{rate:>10.0f} samples per CPU-second{rate / median['PyTorch']:>8.2f}")


main()
