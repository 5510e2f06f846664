"""Escape text from files and users, such as names, so that Markdown shows it literally."""

import re

# Characters with a meaning in Markdown. They include the bracket after `!`, as viser parses an image even if its `!` is
# escaped.
MARKS = re.compile(r"[\\`*<>|~$&]|\](?=[\[(:])|(?<=!)\[|(?<![0-9A-Za-z])_|_(?![0-9A-Za-z])")
UNPRINTABLE = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")  # characters that are invalid in XML


def printable(text: str) -> str:
    """Return the text without control characters and unpaired surrogates, which are invalid in XML and UTF-8."""
    return UNPRINTABLE.sub("\N{REPLACEMENT CHARACTER}", text)


def escaped(text: str) -> str:
    """Return the text on one line, escaped so that Markdown shows it literally."""
    return MARKS.sub(r"\\\g<0>", " ".join(printable(text).splitlines()))
