"""Execute notebooks: NAME.py becomes NAME.ipynb with its outputs. `make notebooks` calls this.

A notebook runs in a temporary copy of the folders that it uses, so that it finds no results of earlier runs. Pictures
are reduced to 256 colours, and cells are numbered, so that a new execution changes little else than results.
"""

import base64
import io
import sys
import tempfile
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from PIL import Image

HERE = Path(__file__).parent


def make(name: str) -> None:
    """Execute a notebook and write it next to its script."""
    notebook = jupytext.read(HERE / f"{name}.py")
    for number, cell in enumerate(notebook.cells):
        cell.id = f"cell-{number}"
    with tempfile.TemporaryDirectory() as scratch:
        for folder in ("configs", "sweeps"):
            (Path(scratch) / folder).symlink_to(HERE.parent / folder)
        (own := Path(scratch) / "notebooks").mkdir()
        place = {"metadata": {"path": str(own)}}
        NotebookClient(notebook, timeout=None, record_timing=False, resources=place).execute()
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if png := output.get("data", {}).get("image/png"):
                output["data"]["image/png"] = smaller(png)
    nbformat.write(notebook, part := HERE / f".{name}.part")
    part.replace(HERE / f"{name}.ipynb")  # never half-written


def smaller(png: str) -> str:
    """Return a picture in base64 with 256 colours."""
    picture, small = Image.open(io.BytesIO(base64.b64decode(png))), io.BytesIO()
    small_palette = picture.convert("RGB").quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)
    small_palette.save(small, "PNG", optimize=True)
    return base64.b64encode(small.getvalue()).decode()


if __name__ == "__main__":
    for each in sys.argv[1:]:
        print(each, flush=True)
        make(each)
