"""Polynomials by least squares, without any library: validate one fold, choose a degree, or fit all points."""
import json
import os
import sys


def read(path):
    with open(path) as file:
        return [tuple(map(float, line.split(","))) for line in file.read().split()[1:]]


def fit(points, degree):
    """Solves the normal equations by elimination with pivots."""
    size = degree + 1
    rows = [
        [sum(x ** (i + j) for x, _, _ in points) for j in range(size)] + [sum(y * x**i for x, y, _ in points)]
        for i in range(size)
    ]
    for at in range(size):
        pivot = max(range(at, size), key=lambda row: abs(rows[row][at]))
        rows[at], rows[pivot] = rows[pivot], rows[at]
        for row in range(size):
            if row != at:
                factor = rows[row][at] / rows[at][at]
                rows[row] = [a - factor * b for a, b in zip(rows[row], rows[at])]
    return [rows[i][size] / rows[i][i] for i in range(size)]


def value(weights, x):
    return sum(weight * x**power for power, weight in enumerate(weights))


def validate(path, degree, fold, out):
    points = read(path)
    weights = fit([point for point in points if point[2] != float(fold)], int(degree))
    held = [point for point in points if point[2] == float(fold)]
    with open(out, "w") as file:
        file.write(f"{sum((value(weights, x) - y) ** 2 for x, y, _ in held) / len(held):.6f}\n")


def choose(table, best):
    with open("inputs.json") as file:
        items = json.load(file)["errors"]
    errors = {}
    for item in items:
        with open(item["path"]) as file:
            errors.setdefault(int(item["labels"]["degree"]), []).append(float(file.read()))
    means = {degree: sum(found) / len(found) for degree, found in sorted(errors.items())}
    with open(table, "w") as file:
        file.write("degree,folds,mean squared error\n")
        file.writelines(f"{degree},{len(errors[degree])},{mean:.4f}\n" for degree, mean in means.items())
    with open(best, "w") as file:
        file.write(f"{min(means, key=means.get)}\n")


def final(path, degree, out):
    if os.path.exists(degree):
        with open(degree) as file:
            degree = file.read()
    with open(out, "w") as file:
        file.write("power,weight\n")
        file.writelines(f"{power},{weight:.6f}\n" for power, weight in enumerate(fit(read(path), int(degree))))


globals()[sys.argv[1]](*sys.argv[2:])
