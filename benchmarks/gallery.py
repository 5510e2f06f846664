"""The pictures of docs/gallery.md, made by the commands on that page.

python -m benchmarks gallery [--only NAME] [--work FOLDER]
"""

import argparse
import re
import shlex
import shutil
import tempfile
import time
from contextlib import chdir
from pathlib import Path
from typing import NamedTuple

from PIL import Image

from htcp_jax.cli import main as htcp

ROOT = Path(__file__).parents[1]
FIGURES, PAGE = ROOT / "docs" / "figures", ROOT / "docs" / "gallery.md"
IMAGE = re.compile(r"^!\[.*?\]\(figures/(\S+)\)", re.DOTALL | re.MULTILINE)
BLOCK = re.compile(r"^```sh\n(.*?)^```$", re.DOTALL | re.MULTILINE)
WIDTH = 900  # maximum width of a picture in the gallery's folder [pixels]
SCREENSHOT, DRAWN_S = "a screenshot", 60
BROWSERS, FLAGS = ("chromium", "chromium-browser", "google-chrome"), ("--no-sandbox", "--enable-unsafe-swiftshader")


class Section(NamedTuple):
    """Section of the page: its pictures, and the commands that make them."""

    pictures: tuple[str, ...]  # names in docs/figures
    commands: tuple[str, ...]
    files: tuple[str, ...]  # files that the commands write, in the order of the pictures


def main() -> None:
    """Run the commands of the page and replace its pictures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default="", help="make only pictures whose names contain this text")
    parser.add_argument("--work", type=Path, help="folder of the plans; by default a temporary one")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        work = (given.work or Path(scratch)).resolve()
        work.mkdir(parents=True, exist_ok=True)
        for folder in ("configs", "sweeps"):
            if not (work / folder).exists():
                (work / folder).symlink_to(ROOT / folder)
        for section in sections(PAGE.read_text(encoding="utf-8")):
            if any(given.only in picture for picture in section.pictures):
                make(section, work)


def sections(page: str) -> list[Section]:
    """Return the sections of the page."""
    found = []
    for text in page.split("\n## ")[1:]:
        lines = [line.partition("#") for block in BLOCK.findall(text) for line in block.splitlines()]
        files = [file.strip() for _, _, comment in lines if comment for file in comment.split(",")]
        found.append(Section(tuple(IMAGE.findall(text)), tuple(command.strip() for command, *_ in lines), tuple(files)))
    return found


def make(section: Section, work: Path) -> None:
    """Run a section's commands in the folder `work`, and replace its pictures."""
    with chdir(work):
        for command in section.commands:
            print(command, flush=True)
            if SCREENSHOT in section.files:
                take_screenshot(command.split()[-1], Path(SCREENSHOT))
            else:
                htcp(shlex.split(command)[1:])
        for name, file in zip(section.pictures, section.files, strict=True):
            (FIGURES / name).parent.mkdir(exist_ok=True)
            if name.startswith("gallery/"):
                save_small(Path(file), FIGURES / name)
            else:
                shutil.copy(file, FIGURES / name)


def save_small(picture: Path, out: Path) -> None:
    """Save a picture with at most WIDTH columns and 256 colours."""
    image = Image.open(picture).convert("RGB")
    if image.width > WIDTH:
        image = image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.Resampling.LANCZOS)
    image.quantize(256, Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)


def take_screenshot(folder: str, out: Path) -> None:
    """Save a picture of the viewer's page for a plan's folder; needs Playwright and a browser."""
    from playwright.sync_api import sync_playwright

    from htcp_jax.viewer import Viewer
    from htcp_jax.viewer.replay import open_replays

    viewer = Viewer(open_replays(folder), port=0)
    viewer.go_to(60)
    browser = next(filter(None, map(shutil.which, BROWSERS)))
    with sync_playwright() as driver:
        page = driver.chromium.launch(executable_path=browser, args=list(FLAGS)).new_page(
            viewport={"width": 1280, "height": 760}
        )
        page.goto(viewer.address)
        page.get_by_role("slider").first.wait_for(timeout=1e3 * DRAWN_S)
        time.sleep(DRAWN_S)  # without a GPU the page needs this time to draw
        for notice in page.locator(".mantine-Notification-closeButton").all():  # that drawing is slow
            notice.click()
        time.sleep(1)
        page.screenshot(path=out, type="png", timeout=1e3 * DRAWN_S)
    viewer.stop()


if __name__ == "__main__":
    main()
