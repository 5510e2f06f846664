"""Text that others wrote, names above all, for Markdown that shows it as it is."""

import re

# Markdown's own characters; an image's bracket, too, which viser looks for itself, backslash or not.
MARKS = re.compile(r"[\\`*<>|~$&]|\](?=[\[(:])|(?<=!)\[|(?<![0-9A-Za-z])_|_(?![0-9A-Za-z])")
UNPRINTABLE = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # no characters of XML


def printable(text: str) -> str:
    """The text without control characters and halves of surrogate pairs, which neither XML nor UTF-8 can hold."""
    return UNPRINTABLE.sub("\N{REPLACEMENT CHARACTER}", text)


def escaped(text: str) -> str:
    """The text for Markdown, on one line, that reads as it is."""
    return MARKS.sub(r"\\\g<0>", " ".join(printable(text).splitlines()))
