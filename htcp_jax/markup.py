"""Escape text from outside, names above all, so that Markdown shows it literally."""

import re

# Markdown's own characters; an image's bracket, too, which viser parses itself, backslash or not.
MARKS = re.compile(r"[\\`*<>|~$&]|\](?=[\[(:])|(?<=!)\[|(?<![0-9A-Za-z])_|_(?![0-9A-Za-z])")
UNPRINTABLE = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # no characters of XML


def printable(text: str) -> str:
    """Return the text without control characters and unpaired surrogates, which are invalid in XML and UTF-8."""
    return UNPRINTABLE.sub("\N{REPLACEMENT CHARACTER}", text)


def escaped(text: str) -> str:
    """Return the text on one line, escaped so that Markdown shows it literally."""
    return MARKS.sub(r"\\\g<0>", " ".join(printable(text).splitlines()))
