"""Sizes of the crops against the literature; the table in docs/plants.md is made here.

python tests/test_plant_crops.py prints that table: 20 seeds of each crop, not made ready.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import plantsim as ps
from plantsim.plant.foliage import known

SEEDS = 20
PAGE = Path(__file__).resolve().parent.parent / "docs" / "plants.md"

BRYM = "4 trees on CG.6210, 8 years, Brym and Ernest"
ROBINSON = "Robinson, tall spindle"
KIMMEL = "Kimmel Orchard 2015"
NC140 = "M.9 T337, fifth year, 2010 NC-140 Fuji trial"
VOGEL = "Vogel leader on Gisela, Organic Orchard Fruits"
LITHUANIA = "Gisela 5, seventh leaf, Plants 12:614, 2023"
NURSERY = "nursery tree of 2 ft and 2 years of 13 to 24 in"
OAKVILLE = "six trellises, Oakville, Am. J. Enol. Vitic."
NODES = "10 to 20 nodes (wineskills.co.uk) of 49 to 55 mm (Oakville)"
ARSHAD = "Arshad and others 2024, 10 weeks, a truss a week"
GROVIDA = "1 cm (grovida.us), within 10 %"
COSTA_RICA = "12 genotypes, Elizondo-Cabalceta and Monge-Perez 2016"
CORN = "dimensionsguide.com"
CAMAROSA = "longest in pots, Not. Sci. Biol. 2024; plants up to 30 cm"


def level(plant, k):
    return [b for b in plant.limbs if b.level == k]


def thickness(limb, height):
    """Diameter [m] of an upright limb at a height [m]; below zero, from its top."""
    z = limb.points[:, 2]
    return 2 * float(np.interp(height if height >= 0 else z.max() + height, z, limb.radius))


def stem(height):
    return lambda p: thickness(p.limbs[0], height)


def lowest(p):
    return min(b.points[0, 2] for b in level(p, 1))


def lengths(k, take):
    return lambda p: take([b.length for b in level(p, k)])


def trusses(p):
    """Distance [m] of trusses: as many laterals as `every` in foliage.toml says."""
    z = np.sort([b.points[0, 2] for b in level(p, 1)])
    return known("tomato", "fruit")["every"] * (z[-1] - z[0]) / (len(z) - 1)


class Row(NamedTuple):
    crop: str
    figure: str
    unit: str
    measure: Callable[[ps.Skeleton], float]
    low: float  # of the literature, in the unit
    high: float
    source: str


HEIGHT = ps.Skeleton.height.fget
ROWS = [
    Row("apple", "height", "m", HEIGHT, 2.9, 4.5, BRYM),
    Row("apple", "trunk 0.2 m above ground", "mm", stem(0.2), 101, 110, BRYM),
    Row("apple", "scaffold limbs", "", lambda p: len(level(p, 1)), 8, 15, BRYM),
    Row("apple", "their mean length", "m", lengths(1, np.mean), 1.02, 1.64, BRYM),
    Row("apple_spindle", "height", "m", HEIGHT, 3.0, 3.7, ROBINSON + ", 10 to 12 ft"),
    Row("apple_spindle", "trunk at 0.3 m", "mm", stem(0.3), 38, 67, NC140),
    Row("apple_spindle", "lowest branch at", "m", lowest, 0.61, 0.71, KIMMEL),
    Row("apple_spindle", "longest branch", "m", lengths(1, max), 0.61, 0.91,
        ROBINSON + ", 4 to 6 ft across"),
    Row("apple_spindle", "thickest branch", "mm",
        lambda p: max(2 * b.base_radius for b in level(p, 1)), 0, 19,
        KIMMEL + ", cut above 3/4 in"),
    Row("cherry", "height", "m", HEIGHT, 3.0, 3.7, VOGEL + ", 10 to 12 ft"),
    Row("cherry", "trunk at 0.3 m", "mm", stem(0.3), 93, 116, LITHUANIA),
    Row("cherry", "longest limb", "m", lengths(1, max), 1.2, 1.8,
        VOGEL + ", 8 to 12 ft apart"),
    Row("citrus_young", "height", "m", HEIGHT, 1.27, 1.83, NURSERY),
    Row("grapevine", "trunk up to the arms", "m", lowest, 0.6, 1.2,
        "cordone speronato, vineyardsaccessories.com"),
    Row("grapevine", "trunk at 0.1 m", "mm", stem(0.1), 43, 84,
        "girths of 135 to 265 mm, Sunmuscat on 7 stocks"),
    Row("grapevine", "canes a metre of arm", "",
        lambda p: len(level(p, 2)) / sum(b.length for b in level(p, 1)), 9.1, 14.0,
        OAKVILLE),
    Row("grapevine", "length of canes", "m", lengths(2, np.mean), 0.49, 1.10, NODES),
    Row("grapevine", "canes at their foot", "mm",
        lambda p: np.mean([2 * b.base_radius for b in level(p, 2)]), 6.4, 12.7,
        "1/4 to 1/2 in, Hellman, eXtension"),
    Row("tomato", "height", "m", HEIGHT, 2.0, 2.67, ARSHAD),
    Row("tomato", "distance of trusses", "m", trusses, 0.20, 0.267, ARSHAD),
    Row("tomato", "stem 0.15 m below its top", "mm", stem(-0.15), 9, 11, GROVIDA),
    Row("pepper", "height", "m", HEIGHT, 0.4, 1.0, "pinova.hr"),
    Row("pepper", "stem up to the fork", "m",
        lambda p: min(b.points[0, 2] for b in level(p, 0)[1:]), 0.258, 0.369, COSTA_RICA),
    Row("pepper", "stem at its foot", "mm", stem(0.0), 12.5, 15.8, COSTA_RICA),
    Row("pepper", "stems above the fork", "", lambda p: len(level(p, 0)), 2, 4,
        "pinova.hr"),
    Row("maize", "height", "m", HEIGHT, 1.2, 3.0, "CIMMYT, Maize Doctor"),
    Row("maize", "stalk at 0.15 m", "mm", stem(0.15), 20, 30, CORN),
    Row("maize", "longest blade", "m", lengths(1, max), 0.5, 1.0, CORN),
    Row("strawberry", "length of petioles", "m", lengths(1, np.mean), 0.127, 0.30,
        CAMAROSA),
    Row("strawberry", "leaves", "", lambda p: len(level(p, 1)), 5, 29,
        "dmcoffee.blog; Not. Sci. Biol. 2024"),
]  # fmt: skip


@cache
def grown(crop):
    return [ps.weber_penn(crop, rng=seed, ready=False) for seed in range(SEEDS)]


def ours(row):
    factor = 1e3 if row.unit == "mm" else 1.0
    return factor * np.array([row.measure(p) for p in grown(row.crop)], dtype=float)


def line(row):
    """Row of the table in the docs."""
    unit = f" {row.unit}".rstrip()

    def span(low, high):
        same = f"{low:.3g}" == f"{high:.3g}"
        return f"{low:.3g}{unit}" if same else f"{low:.3g} to {high:.3g}{unit}"

    x = ours(row)
    spread = "" if np.ptp(x) < 1e-9 else f" ({x.min():.3g} to {x.max():.3g})"
    there = f"below {row.high:.3g}{unit}" if not row.low else span(row.low, row.high)
    return (
        f"| {row.crop} | {row.figure} | {x.mean():.3g}{unit}{spread} | {there} "
        f"| {row.source} |"
    )


@pytest.mark.parametrize("row", ROWS, ids=lambda r: f"{r.crop}-{r.figure}")
def test_crops_have_the_sizes_of_the_literature(row):
    mean = ours(row).mean()
    assert row.low <= mean <= row.high, f"{mean:.3g} {row.unit}"


def test_every_crop_is_held_and_the_docs_have_the_table():
    crops = {n for n in ps.species_names() if "Own estimate" in ps.species(n).source}
    assert len(crops) == 9
    assert {row.crop for row in ROWS} == crops
    page = PAGE.read_text(encoding="utf-8")
    assert [row.figure for row in ROWS if line(row) not in page] == []


def test_masses_have_the_sizes_of_the_literature():
    """A grape cluster, a vine's leaf, a tomato's leaf area: as in foliage.toml."""
    assert 9.8 / 69 < known("grapevine", "fruit")["mass"] < 11.8 / 75  # kg of clusters
    leaf = known("grapevine", "leaf")
    area = leaf["mass"] / 0.22  # [m2] at 22 mg/cm2
    assert 0.0089 < area < 0.0097
    assert 0.049 <= leaf["spacing"] <= 0.055  # internodes
    plant = ps.weber_penn("tomato", rng=1).with_leaves("tomato")
    assert 3 / 3.75 < plant.masses.total / 0.22 < 4 / 2.5  # [m2]: area index over stems


if __name__ == "__main__":
    print("| crop | figure | ours: mean (range) | literature | source |")
    print("|---|---|---|---|---|")
    print("\n".join(line(row) for row in ROWS))
