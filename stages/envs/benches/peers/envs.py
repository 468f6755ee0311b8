"""Speed of our environments beside EnvPool's and Gymnasium's, one process each, one thread, random actions.

    python3 -m venv v && v/bin/pip install 'gymnasium[box2d]==1.4.0' envpool==1.2.5
    v/bin/python stages/envs/benches/peers/envs.py [ROUNDS=5] [SECONDS=1.5]

Every configuration gets ROUNDS slices of SECONDS, in turn, so that whatever else the machine does hits all of them
alike. Printed are medians of steps per CPU-second (user and system time of the process that steps) and what ours is
a multiple of. Ours is built and started by `cargo bench -p dril-envs -- --serve`, unless OURS names the program.
CarRacing: ours gives 84 x 84 x 4, the others 96 x 96 RGB as it comes.
"""
import os, statistics, subprocess, sys, time

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"
os.environ.setdefault("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("SDL_AUDIODRIVER", "dummy")
import envpool
import gymnasium as gym
import numpy as np

ROUNDS = int(sys.argv[1]) if len(sys.argv) > 1 else 5
SECONDS = float(sys.argv[2]) if len(sys.argv) > 2 else 1.5
random = np.random.default_rng(0)


def actions(game, shape=()):
    low, high = {"car": ([-1, 0, 0], [1, 1, 1]), "lander": ([-1, -1], [1, 1])}[game]
    return [random.uniform(low, high, size=(*shape, len(low))).astype(np.float32) for _ in range(256)]


def timed(step, steps_each):
    """A slice: steps and CPU-seconds; `step(k)` makes `steps_each` steps."""
    k = 0

    def play(seconds):
        nonlocal k
        start, steps = time.process_time(), 0
        while time.process_time() - start < seconds:
            for _ in range(8):
                step(k)
                k += 1
                steps += steps_each
        return steps, time.process_time() - start

    return play


def gymnasium(game, env):
    drawn, seed = actions(game), 0
    env.reset(seed=seed)

    def step(k):
        nonlocal seed
        _, _, terminated, truncated, _ = env.step(drawn[k % len(drawn)])
        if terminated or truncated:
            seed += 1
            env.reset(seed=seed)

    return timed(step, 1)


def pool(game, name, count, **settings):
    env = envpool.make_gymnasium(name, num_envs=count, num_threads=1, seed=0, **settings)
    drawn = actions(game, (count,))
    env.reset()
    return timed(lambda k: env.step(drawn[k % len(drawn)]), count)


class Ours:
    """Our program, which measures slices on demand."""

    def __init__(self):
        command = os.environ.get("OURS", "cargo bench -q -p dril-envs --bench speed --").split()
        self.process = subprocess.Popen([*command, "--serve"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)

    def slice(self, name):
        def play(seconds):
            self.process.stdin.write(f"{name} {seconds}\n")
            self.process.stdin.flush()
            steps, spent = self.process.stdout.readline().split()
            return int(steps), float(spent)

        return play


ours = Ours()
car = dict(lap_complete_percent=1.0)
games = {
    "CarRacing": {
        "ours, v3, 84x84x4": ours.slice("car-racing-v3"),
        "ours, v0, 84x84x4": ours.slice("car-racing-v0"),
        "envpool CarRacing-v3, 1 environment": pool("car", "CarRacing-v3", 1, max_episode_steps=1000, **car),
        "envpool CarRacing-v3, 8 environments": pool("car", "CarRacing-v3", 8, max_episode_steps=1000, **car),
        "gymnasium CarRacing-v3": gymnasium("car", gym.make("CarRacing-v3", **car)),
    },
    "LunarLanderContinuous": {
        "ours": ours.slice("lunar-lander"),
        "envpool LunarLanderContinuous-v3, 1 environment": pool("lander", "LunarLanderContinuous-v3", 1),
        "envpool LunarLanderContinuous-v3, 8 environments": pool("lander", "LunarLanderContinuous-v3", 8),
        "gymnasium LunarLander-v3, continuous": gymnasium("lander", gym.make("LunarLander-v3", continuous=True)),
    },
}
rates = {game: {name: [] for name in rows} for game, rows in games.items()}
for rows in games.values():
    for play in rows.values():
        play(0.3)
for _ in range(ROUNDS):
    for game, rows in games.items():
        for name, play in rows.items():
            steps, spent = play(SECONDS)
            rates[game][name].append(steps / spent)
ours.process.stdin.close()
print(f"{ROUNDS} rounds of {SECONDS} CPU-seconds, load averages {os.getloadavg()}")
for game, rows in rates.items():
    first = next(iter(rows))
    for name, seen in rows.items():
        ratio = statistics.median(a / b for a, b in zip(rows[first], seen))
        print(f"{game:22} {name:48} {statistics.median(seen):10.0f} steps per CPU-second   ours is {ratio:7.2f} x")
