"""How often, and with what return, a simple pilot lands Gymnasium's LunarLander: the figures that `env check` compares with.

    pip install "gymnasium[box2d]==1.4.0"
    python stages/envs/benches/peers/landings.py 1000

The pilot flies by the rules of `stages/envs/src/check/lunar_lander/pilot.rs`.
"""

import sys

import gymnasium
import numpy


def pilot(seen):
    x, y, dx, dy, angle, turn, left, right = seen
    wanted_angle = numpy.clip(0.5 * x + 1.0 * dx, -0.4, 0.4)
    wanted_height = 0.55 * abs(x)
    roll = 0.5 * (wanted_angle - angle) - turn
    lift = 0.5 * (wanted_height - y) - 0.5 * dy
    if left or right:
        roll, lift = 0.0, -0.5 * dy
    return numpy.clip([20 * lift - 1, -20 * roll], -1, 1)


def flight(env, seed):
    seen, _ = env.reset(seed=seed)
    total = 0.0
    while True:
        seen, reward, terminated, truncated, _ = env.step(pilot(seen))
        total += reward
        if terminated or truncated:
            return total, terminated and reward == 100


def main():
    seeds = int(sys.argv[1])
    env = gymnasium.make("LunarLander-v3", continuous=True)
    flights = [flight(env, seed) for seed in range(seeds)]
    returns = numpy.array([total for total, _ in flights])
    landed = numpy.mean([landed for _, landed in flights])
    error = returns.std() / seeds**0.5
    print(f"Gymnasium {gymnasium.__version__}, {seeds} seeds: landed {landed:.3f}, "
          f"mean return {returns.mean():.2f} ± {error:.2f} (standard error)")


if __name__ == "__main__":
    main()
