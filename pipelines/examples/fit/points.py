"""Points on one period of a sine, with noise, each in one of five folds."""
import math
import random
import sys

count, noise, seed = int(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3])
rng = random.Random(seed)
with open(sys.argv[4], "w") as file:
    file.write("x,y,fold\n")
    for number in range(count):
        x = number / (count - 1)
        file.write(f"{x:.6f},{math.sin(2 * math.pi * x) + rng.gauss(0, noise):.6f},{number % 5}\n")
