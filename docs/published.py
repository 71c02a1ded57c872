"""The results of docs/published-suites.md and of the README's table: python docs/published.py RUN, of `beambench run full`.

Tables are written between the comments `table:NAME` and `end:NAME`, pictures as docs/pictures/published-<quantity>.png. Nothing
is typed by hand: what the run's summary.csv and ranking.csv do not hold is not shown.
"""

from __future__ import annotations

import sys
from pathlib import Path

import altair as alt
import numpy as np
import pandas as pd
import vl_convert
from marked import write_tables

from beambench.captures.layouts import layout_of
from beambench.estimators.labels import label_of

HERE = Path(__file__).parent
#: Heading of each quantity that is scored, in the order of the page.
TITLES = {
    ("gated", "range"): "Range-gated imaging: range",
    ("waveform", "range"): "Pulsed waveforms: range",
    ("amcw", "range"): "Amplitude modulation: range",
    ("laser_line", "column"): "Laser line: column",
    ("laser_line", "point"): "Laser line: points",
    ("wavefront", "spot"): "Shack-Hartmann: places of spots",
    ("wavefront", "slope"): "Shack-Hartmann: slopes",
    ("wavefront", "zernike"): "Shack-Hartmann: Zernike coefficients",
    ("wavefront", "phase"): "Shack-Hartmann: phase",
}
#: Half-width of the 95 % interval of an error, as a fraction, that a published row should not exceed.
WANTED = 0.05
#: Share of elements that may fail or not be answered where an error is that of noise.
SOUND = 1e-3


def _percent(share: float) -> str:
    """A share in percent to two digits, and to a whole number from 10 % on."""
    return f"{100 * share:.0f} %" if share >= 0.1 else f"{100 * share:.2g} %"


def rows_of(run: Path) -> pd.DataFrame:
    """The rows of summary.csv without stress, with `name`, `half` (half-width of the interval) and `over` (error / bound)."""
    rows = pd.read_csv(run / "summary.csv", dtype={"level": str, "level2": str, "params": str})
    rows = rows[(rows.stress.fillna("none") == "none") & (rows.n > 0)].copy()
    rows["name"] = [label_of(e, p) for e, p in zip(rows.estimator, rows.params.fillna(""), strict=True)]
    rows["half"] = np.sqrt(rows.rmse_full_hi / rows.rmse_full_lo) - 1.0
    rows["over"] = rows.rmse / rows.bound  # both of the answered elements
    return rows


def intervals(rows: pd.DataFrame) -> str:
    """How wide the intervals of the errors are, for each quantity and condition: those of estimators that hardly fail on a
    scene, and the others, whose error is that of their few or many failures."""
    lines = [
        "| modality | quantity | condition | failures < .1 %: errors | half-width ≤ 5 % | median | widest "
        "| more failures: errors | half-width ≤ 5 % |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for (modality, quantity, condition), own in rows.groupby(["modality", "quantity", "condition"], sort=False):
        known = own[own.half.notna()]
        lost = known.failure_rate + 1.0 - known.coverage
        sound, other = known[lost < SOUND], known[lost >= SOUND]
        worst = sound.loc[sound.half.idxmax()] if len(sound) else None
        lines.append(
            f"| {modality} | {quantity} | {condition} | {len(sound)} | {_share(sound.half)} "
            + (
                f"| {100 * sound.half.median():.1f} % | {100 * worst.half:.0f} % (`{worst['name']}`, {worst.scene}) "
                if worst is not None
                else "| – | – "
            )
            + f"| {len(other)} | {_share(other.half)} |"
        )
    return "\n".join(lines)


def _share(half: pd.Series) -> str:
    return f"{np.mean(half <= WANTED):.0%}" if len(half) else "–"


def errors(own: pd.DataFrame, factor: float) -> str:
    """Errors of a quantity, matched: estimators by the geometric mean over scenes, which stand below one another."""
    scenes = list(dict.fromkeys(own.scene))
    matched = own[own.condition == "matched"]
    order = ranked(matched)
    lines = ["| estimator | " + " | ".join(scenes) + " |", "|---" * (len(scenes) + 1) + "|"]
    bound = matched.groupby("scene").bound.min()
    lines.append("| *bound* | " + " | ".join(_number(bound.get(s, np.nan) * factor, "*") for s in scenes) + " |")
    for name in order:
        by = matched[matched["name"] == name].set_index("scene")
        lines.append(f"| `{name}` | " + " | ".join(_cell(by, s, factor) for s in scenes) + " |")
    return "\n".join(lines)


def ranked(matched: pd.DataFrame) -> list[str]:
    """Names by the geometric mean of error/best error over the scenes that each reads."""
    best = matched.groupby("scene").rmse_full.transform("min")
    return list(np.log(matched.rmse_full / best).groupby(matched["name"]).mean().sort_values().index)


def _number(value: float, mark: str = "") -> str:
    return "–" if not np.isfinite(value) else f"{mark}{float(f'{value:.3g}'):g}{mark}"


def _cell(by: pd.DataFrame, scene: str, factor: float) -> str:
    if scene not in by.index:
        return ""
    row = by.loc[scene]
    text = _number(row.rmse_full * factor)
    if row.half > WANTED:
        text += f" ±{100 * row.half:.0f}%"
    return text if row.coverage >= 0.9995 else f"{text} ({100 * row.coverage:.3g}%)"


def overview(own: pd.DataFrame, ranks: pd.DataFrame) -> str:
    """Rank, error over bound, failures, stated errors and cost of each estimator of a quantity."""
    lines = [
        "| estimator | rank | on these scenes | error / bound | calibrated | failed | coverage | z | CPU ratio |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    matched, other = own[own.condition == "matched"], own[own.condition == "calibrated"]
    cost = matched.groupby("name").apply(lambda r: float((r.cpu_s * r.seeds).sum() / r.n.sum()), include_groups=False)
    for name in ranked(matched):
        rows, declared = matched[matched["name"] == name], other[other["name"] == name]
        rank = ranks[ranks.estimator == name]
        place = here = "–"
        if not rank.empty:
            place = _span(int(rank.rank_lo.iloc[0]), int(rank.rank_hi.iloc[0]))
            here = _span(int(rank.here_lo.iloc[0]), int(rank.here_hi.iloc[0]))
        failed = float((rows.failure_rate * rows.n).sum() / rows.n.sum())
        covered = float((rows.coverage * rows.n).sum() / rows.n.sum())
        z = float(np.sqrt((rows.z_rms**2 * rows.n).sum() / rows.n[rows.z_rms.notna()].sum()))
        lines.append(
            f"| `{name}` | {place} | {here} | {_number(_middle(rows))} | {_number(_middle(declared))} "
            f"| {_percent(failed)} | {100 * covered:.4g} % | {_number(z)} | {_number(cost[name] / cost.min())} |"
        )
    return "\n".join(lines)


def shown(modality: str, quantity: str) -> tuple[float, str]:
    """Factor and unit in which a quantity is shown."""
    given = (q for stage in layout_of(modality).stages for q in stage.gives if q.name == quantity)
    found = next(given)
    return found.shown if found.shown[1] else (1.0, found.unit)


def _middle(rows: pd.DataFrame) -> float:
    """Median over scenes of error/bound, of scenes whose bound can be reached (`regular`: enough light in most seeds)."""
    kept = rows.over[np.isfinite(rows.over) & (rows.regular > 0.5)]
    return float(kept.median()) if len(kept) else float("nan")


def _span(low: int, high: int) -> str:
    return str(low) if low == high else f"{low}–{high}"


def shown_in_readme(rows: pd.DataFrame, ranks: pd.DataFrame) -> str:
    """The three best of each quantity: error over bound, and the share of failed elements."""
    lines = [
        "| quantity | scenes | best: error / bound (failed) | second | third | cheapest |", "|---|---|---|---|---|---|",
    ]  # fmt: skip
    for (modality, quantity), title in TITLES.items():
        own = rows[(rows.modality == modality) & (rows.quantity == quantity) & (rows.condition == "matched")]
        if own.empty:
            continue
        names = ranked(own)
        cost = own.groupby("name").apply(lambda r: float((r.cpu_s * r.seeds).sum() / r.n.sum()), include_groups=False)
        cells = [_short(own[own["name"] == name], name) for name in names[:3]] + ["–"] * max(0, 3 - len(names))
        cheap = str(cost.idxmin())
        lines.append(
            f"| {title} | {own.scene.nunique()} | "
            + " | ".join(cells)
            + f" | {_short(own[own['name'] == cheap], cheap)} |"
        )
    return "\n".join(lines)


def _short(rows: pd.DataFrame, name: str) -> str:
    failed = float((rows.failure_rate * rows.n).sum() / rows.n.sum())
    return f"`{name}`: {_number(_middle(rows))} ({_percent(failed)})"


def picture(own: pd.DataFrame, title: str, path: Path) -> None:
    """Error over bound against CPU time of an element, matched: a point is the median over scenes, the line their range."""
    matched = own[(own.condition == "matched") & np.isfinite(own.over) & (own.cpu_s > 0)]
    points = pd.DataFrame([
        {
            "name": name, "cpu_us": 1e6 * float((r.cpu_s * r.seeds).sum() / r.n.sum()), "over": _middle(r),
            "low": float(r.over[r.regular > 0.5].min()), "high": float(r.over[r.regular > 0.5].max()),
        }
        for name, r in matched.groupby("name")
    ])  # fmt: skip
    points = points[np.isfinite(points.over)]
    names = alt.Legend(title=None, labelLimit=420, symbolSize=110, columns=1)
    place = alt.X(
        "cpu_us:Q", scale=alt.Scale(type="log", nice=False, padding=20), title="CPU time of an element, µs (log)"
    )
    colour = alt.Color("name:N", legend=names, scale=alt.Scale(scheme="tableau20"))
    axis = alt.Scale(type="log", nice=False, padding=12)
    base = alt.Chart(points)
    lines = base.mark_rule(opacity=0.5, color="#888888").encode(x=place, y=alt.Y("low:Q", scale=axis), y2="high:Q")
    marks = base.mark_point(filled=True, size=90, opacity=1).encode(
        x=place, color=colour, shape=alt.Shape("name:N", legend=names),
        y=alt.Y("over:Q", scale=axis, title="error / bound of what is answered (log)"),
    )  # fmt: skip
    ones = alt.Chart(pd.DataFrame({"y": [1.0]})).mark_rule(strokeDash=[4, 4]).encode(y="y:Q")
    chart = (ones + lines + marks).properties(width=460, height=320, title=title)
    path.write_bytes(vl_convert.vegalite_to_png(chart.to_json(), scale=1.5))


def main(run: Path) -> None:
    """Write all tables and pictures."""
    rows = rows_of(run)
    ranks = pd.read_csv(run / "ranking.csv")
    tables = {"intervals": intervals(rows)}
    for (modality, quantity), title in TITLES.items():
        own = rows[(rows.modality == modality) & (rows.quantity == quantity)]
        if own.empty:
            raise ValueError(f"{run} has no rows of {modality}, {quantity}")
        factor, unit = shown(modality, quantity)
        of = ranks[(ranks.quantity == quantity) & (ranks.condition == "matched") & (ranks.modality == modality)]
        picture(own, title, HERE / "pictures" / f"published-{modality}-{quantity}.png")
        tables[f"{modality}-{quantity}"] = overview(own, of) + f"\n\nErrors in {unit}:\n\n" + errors(own, factor)
    write_tables(HERE / "published-suites.md", tables)
    write_tables(HERE.parent / "README.md", {"published": shown_in_readme(rows, ranks)})


if __name__ == "__main__":
    main(Path(sys.argv[1]))
