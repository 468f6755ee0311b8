"""Estimates pi from darts that are thrown at a square. Goes on from its checkpoint after a kill, with the same result."""
import json
import os
import random
import sys

darts, seed, checkpoints, out = int(sys.argv[1]), int(sys.argv[2]), sys.argv[3], sys.argv[4]
path = os.path.join(checkpoints, "state.json")
rng, done, hits = random.Random(seed), 0, 0
if os.path.exists(path):
    with open(path) as file:
        done, hits, state = json.load(file)
    rng.setstate((state[0], tuple(state[1]), state[2]))

while done < darts:
    hits += rng.random() ** 2 + rng.random() ** 2 < 1.0
    done += 1
    if done % 10000 == 0:
        # Written beside and renamed: a kill in between leaves the old one.
        with open(path + ".new", "w") as file:
            json.dump([done, hits, rng.getstate()], file)
        os.replace(path + ".new", path)
        print(json.dumps({"progress": {"step": done, "total": darts, "unit": "darts"}}), flush=True)

with open(out, "w") as file:
    file.write(f"{4 * hits / darts}\n")
