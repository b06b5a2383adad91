"""A page about a data set: counts, times, histograms, and a sheet of its plants."""

import base64
import html
import os
import tempfile
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from plantsim.datasets.folder import SECONDS, STAGES, Row
from plantsim.datasets.reading import Dataset, open_dataset
from plantsim.datasets.recipe import SPLITS
from plantsim.errors import DatasetError
from plantsim.paths import replacing
from plantsim.view.charts import histograms
from plantsim.view.skeletons import contact_sheet

SHOWN = 30  # plants on the sheet
FAILURES = 50  # failures in the table
CHARTS = {  # column: title, factor
    "height_m": ("height, m", 1),
    "mass_kg": ("mass, kg", 1),
    "limbs": ("limbs", 1),
    "tets": ("thousand tets", 1e-3),
    "worst_gamma": ("worst gamma", 1),
    "young_pa": ("Young, GPa", 1e-9),
    "sag_m": ("sag by own weight, mm", 1e3),
    "touch_force_n": ("force of a touch, N", 1),
    "touch_depth_m": ("depth of a touch, mm", 1e3),
}
STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 68em; margin: 2em auto;
       padding: 0 1em; color: #222; background: #fff }
table { border-collapse: collapse; margin: 1em 0 }
td, th { border-bottom: 1px solid #ddd; padding: .25em .9em .25em 0; text-align: left;
         vertical-align: top }
td.n { text-align: right; font-variant-numeric: tabular-nums }
img { max-width: 100%; height: auto }
h2 { margin-top: 2em }
"""


def summarise(folder: str | os.PathLike[str]) -> Path:
    """Write `summary.html` into the folder of a data set, whole in itself; return its path.

    Raises DependencyError without matplotlib, and DatasetError where there is no plant yet.
    """
    data = open_dataset(folder)
    if not data.rows:
        raise DatasetError(f"{data.folder}: no plant in it yet. Make some first.")
    title = f"{data.folder.resolve().name}: {len(data)} plants"
    parts = [
        f"<h1>{html.escape(title)}</h1>",
        _counts(data),
        "<h2>Species</h2>",
        _species(data),
        "<h2>Seconds a plant, by stage</h2>",
        _stages(data),
        "<h2>Values, over the plants</h2>",
        _picture(_charts(data), "histograms"),
        f"<h2>Plants</h2><p>{min(SHOWN, len(data))} of them, evenly picked; metres.</p>",
        _picture(_sheet(data), "contact sheet"),
    ]
    if data.failures:
        parts += ["<h2>Failures</h2>", _failures(data.failures)]
    page = (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head><body>"
        + "\n".join(parts)
        + "</body></html>\n"
    )
    path = data.folder / "summary.html"
    with replacing(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path


def _counts(data: Dataset) -> str:
    splits = Counter(row["split"] for row in data.rows)
    recipe = data.recipe
    size = sum(row["bytes"] for row in data.rows)
    settled = len(data) + len(data.failures)
    rows = [
        ("plants made", f"{len(data):,} of {recipe.plants:,}"),
        ("failed", f"{len(data.failures):,} ({len(data.failures) / settled:.1%})"),
        *((name, f"{splits[name]:,}") for name in SPLITS),
        ("touches", f"{sum(row['touches'] for row in data.rows):,}"),
        ("on disk", f"{size / 1e6:,.0f} MB, {size / len(data) / 1e6:.2f} MB a plant"),
        ("seed, fingerprint", f"{recipe.seed}, {recipe.fingerprint}"),
    ]
    return _table(("", ""), rows, numbers=False)


def _species(data: Dataset) -> str:
    failed = Counter(row.get("species") for row in data.failures)
    rows = []
    for name in sorted({row["species"] for row in data.rows} | set(map(str, failed))):
        own = data.where(lambda row, name=name: row.get("species") == name)
        if not own.rows:
            rows.append((name, 0, failed[name], "", "", "", ""))
            continue
        height, limbs, tets = (own.column(c) for c in ("height_m", "limbs", "tets"))
        spent = _seconds(own).sum(axis=1)
        rows.append(
            (
                name,
                len(own),
                failed[name],
                f"{height.min():.2f} to {height.max():.2f}",
                f"{limbs.min()} to {limbs.max()}",
                f"{np.median(tets):,.0f}",
                f"{np.median(spent):.1f}",
            )
        )
    head = (
        "species",
        "plants",
        "failed",
        "height, m",
        "limbs",
        "tets, median",
        "s, median",
    )
    return _table(head, rows)


def _stages(data: Dataset) -> str:
    spent = _seconds(data)
    total = spent.sum(axis=1)
    rows = [
        (
            name,
            f"{np.median(each):.2f}",
            f"{each.mean():.2f}",
            f"{each.max():.2f}",
            f"{each.sum() / total.sum():.0%}",
        )
        for name, each in (*zip(STAGES, spent.T, strict=True), ("all", total))
    ]
    return _table(("stage", "median", "mean", "most", "share"), rows)


def _seconds(data: Dataset) -> Any:
    return np.array([[row.get(name, 0.0) for name in SECONDS] for row in data.rows])


def _failures(rows: tuple[Row, ...]) -> str:
    body = [
        (row["plant"], row.get("species", ""), row["kind"], row["reason"])
        for row in rows[:FAILURES]
    ]
    more = len(rows) - len(body)
    tail = f"<p>and {more:,} more in index.csv</p>" if more else ""
    return _table(("plant", "species", "kind", "reason"), body) + tail


def _charts(data: Dataset) -> bytes:
    columns = {title: data.column(name) * by for name, (title, by) in CHARTS.items()}
    columns["seconds a plant"] = _seconds(data).sum(axis=1)
    with tempfile.TemporaryDirectory() as folder:
        return histograms(columns, Path(folder) / "charts.png").read_bytes()


def _sheet(data: Dataset) -> bytes:
    picked = np.unique(np.linspace(0, len(data) - 1, SHOWN).round().astype(int))
    plants = [data[int(i)] for i in picked]
    named = [(f"{p.row['plant']}: {p.row['species']}", p.skeleton) for p in plants]
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "sheet.png"
        return contact_sheet(named, out, columns=min(5, len(named))).read_bytes()


def _picture(png: bytes, what: str) -> str:
    text = base64.b64encode(png).decode()
    return f'<img alt="{what}" src="data:image/png;base64,{text}">'


def _table(head: tuple[str, ...], rows: list[tuple[Any, ...]], numbers: bool = True) -> str:
    def cell(i: int, value: Any) -> str:
        number = numbers and i > 0 and str(value)[:1].isdigit() and " " not in str(value)
        return f"<td{' class=n' if number else ''}>{html.escape(str(value))}</td>"

    top = "".join(f"<th>{html.escape(name)}</th>" for name in head)
    body = "".join(
        f"<tr>{''.join(cell(i, v) for i, v in enumerate(row))}</tr>\n" for row in rows
    )
    return f"<table><tr>{top}</tr>\n{body}</table>"
