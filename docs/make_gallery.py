"""Run the gallery's scripts and keep their pictures: python docs/make_gallery.py [NAME]."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
PICTURES = HERE / "pictures" / "gallery"


def run(script: Path, folder: Path) -> list[Path]:
    """Run a script in a folder and return the pictures that it left there."""
    subprocess.run([sys.executable, str(script)], cwd=folder, check=True)
    return sorted(p for p in folder.iterdir() if p.suffix in (".png", ".gif", ".svg"))


if __name__ == "__main__":
    PICTURES.mkdir(parents=True, exist_ok=True)
    for script in sorted((HERE / "gallery").glob(f"{[*sys.argv, '*'][1]}.py")):
        with tempfile.TemporaryDirectory() as folder:
            for picture in run(script, Path(folder)):
                shutil.copy(picture, PICTURES / picture.name)
