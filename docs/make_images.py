"""Make docs/images/demo.png from the demo's two pictures: python docs/make_images.py."""

import tempfile
from pathlib import Path

import matplotlib.image
import numpy as np

from plantsim.demo import run

HERE = Path(__file__).resolve().parent / "images"


def trimmed(path: Path) -> np.ndarray:
    """Return the picture without the white columns at its sides."""
    picture = matplotlib.image.imread(path)[:, :, :3]
    columns = np.flatnonzero((picture < 0.99).any(axis=(0, 2)))
    return picture[:, max(columns[0] - 40, 0) : columns[-1] + 40]


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        run(7, Path(folder), lambda stage: None)
        pair = [trimmed(Path(folder) / name) for name in ("pushed.png", "stiffness.png")]
    matplotlib.image.imsave(HERE / "demo.png", np.hstack(pair))
