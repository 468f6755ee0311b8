"""The mean error of the estimates of pi by the number of darts: a table, and a figure with both axes logarithmic."""
import json
import math
import sys

with open("inputs.json") as file:
    items = json.load(file)["estimates"]
errors = {}
for item in items:
    with open(item["path"]) as file:
        errors.setdefault(int(item["labels"]["darts"]), []).append(abs(float(file.read()) - math.pi))
rows = [(darts, len(all_), sum(all_) / len(all_)) for darts, all_ in sorted(errors.items())]

with open(sys.argv[1], "w") as file:
    file.write("darts,seeds,mean error\n")
    file.writelines(f"{darts},{seeds},{mean:.6f}\n" for darts, seeds, mean in rows)

points = [(math.log10(darts), math.log10(mean)) for darts, _, mean in rows]
low, high = min(y for _, y in points) - 0.2, max(y for _, y in points) + 0.2
first, last = points[0][0], max(points[-1][0], points[0][0] + 1)


def place(x, y):
    return f"{60 + 300 * (x - first) / (last - first):.1f},{20 + 200 * (high - y) / (high - low):.1f}"


marks = "".join(
    f'<circle cx="{place(x, y).split(",")[0]}" cy="{place(x, y).split(",")[1]}" r="3"/>'
    f'<text x="{place(x, y).split(",")[0]}" y="240" text-anchor="middle">{darts}</text>'
    for (x, y), (darts, _, _) in zip(points, rows)
)
with open(sys.argv[2], "w") as file:
    file.write(
        '<svg xmlns="http://www.w3.org/2000/svg" width="400" height="260" font-family="sans-serif" font-size="11">'
        '<rect width="400" height="260" fill="white"/><path d="M60 20V220H360" fill="none" stroke="black"/>'
        f'<polyline points="{" ".join(place(x, y) for x, y in points)}" fill="none" stroke="steelblue"/>{marks}'
        f'<text x="8" y="30">10^{high:.1f}</text><text x="8" y="220">10^{low:.1f}</text>'
        '<text x="210" y="256" text-anchor="middle">darts</text></svg>\n'
    )
