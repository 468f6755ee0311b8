"""Does the ensemble's reward rank episodes as their scores do? Spearman's correlation in each 40 consecutive episodes.

The policy changes little within 40 episodes, so what remains is the difference between episodes. Reads
`logs/dril-*-episodes.csv` beside this file and prints one row per training: the mean correlation over the windows with
its standard error, and how many steps of an episode had the reward -1 in the quarters of the lowest and highest scores.
Run: python3 docs/results/desk/signal.py (Python 3.9 or newer, nothing else).
"""

import csv
import pathlib
from statistics import fmean, stdev

WINDOW = 40


def ranks(values):
    """Ranks from 0; equal values share the mean of theirs."""
    return [sum(v < x for v in values) + (sum(v == x for v in values) - 1) / 2 for x in values]


def spearman(left, right):
    """The correlation of the ranks; 0 where one side is constant."""
    centred = [[rank - fmean(all_) for rank in all_] for all_ in (ranks(left), ranks(right))]
    spread = [sum(x * x for x in side) ** 0.5 for side in centred]
    return sum(x * y for x, y in zip(*centred)) / (spread[0] * spread[1]) if all(spread) else 0.0


def main():
    print("training,episodes,correlation,error,penalised_lowest,penalised_highest")
    for path in sorted((pathlib.Path(__file__).parent / "logs").glob("dril-*-episodes.csv")):
        with path.open() as file:
            rows = list(csv.DictReader(file))
        scores = [float(row["score"]) for row in rows]
        signals = [float(row["u_signal"]) for row in rows]
        penalised = [(1 - float(row["u_signal"])) / 2 * int(row["length"]) for row in rows]
        starts = range(0, len(rows) - WINDOW + 1, WINDOW)
        found = [spearman(scores[n : n + WINDOW], signals[n : n + WINDOW]) for n in starts]
        order = sorted(range(len(rows)), key=lambda n: scores[n])
        quarter = len(rows) // 4
        low, high = (fmean(penalised[n] for n in part) for part in (order[:quarter], order[-quarter:]))
        name = path.stem.removeprefix("dril-").removesuffix("-episodes")
        error = stdev(found) / len(found) ** 0.5
        print(f"{name},{len(rows)},{fmean(found):.2f},{error:.2f},{low:.1f},{high:.1f}")


main()
