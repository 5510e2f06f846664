"""Statements of a RAPID module: comments and texts removed, each with its line and its routine."""

import re
from collections.abc import Iterator
from typing import NamedTuple

from htcp_jax.io.motions.source import Source

# Words that stand in front of a statement, or alone, without a semicolon.
HEAD = re.compile(
    r"\s*(%%%[^%]*%%%|MODULE\s+\w+\s*(?:\([^)]*\))?|ENDMODULE\b|END(?:PROC|FUNC|TRAP)\b|ERROR\b(?:\s*\([^)]*\))?"
    r"|BACKWARD\b|UNDO\b|(?:LOCAL\s+)?(?:PROC|TRAP|FUNC\s+\w+)\s+\w+\s*(?:\([^)]*\))?)",
    re.IGNORECASE,
)
# Words of the control flow that end without a semicolon.
BLOCK = re.compile(
    r"\s*(IF\b.*?\bTHEN\b|ELSEIF\b.*?\bTHEN\b|ELSE\b|ENDIF\b|FOR\b.*?\bDO\b|ENDFOR\b|WHILE\b.*?\bDO\b|ENDWHILE\b"
    r"|TEST\b.*?(?=\bCASE\b|\bDEFAULT\b|\bENDTEST\b)|CASE\b[^:]*:|DEFAULT\s*:|ENDTEST\b|GOTO\b|IF\b)",
    re.IGNORECASE | re.DOTALL,
)


class Statement(NamedTuple):
    """A statement, or the first word of a block, in a routine."""

    line: int
    text: str
    routine: str  # name in lower case; "" outside of routines
    kind: str  # of the routine: proc, func or trap; "" outside
    handler: bool  # True in an error handler, which runs only after errors
    flow: bool  # True for a word of the control flow

    @property
    def word(self) -> str:
        """The first word in lower case."""
        return re.split(r"\W", self.text, maxsplit=1)[0].lower()


def statements(source: Source) -> Iterator[Statement]:
    """Yield the statements of all modules in a file.

    Raises:
        InputError: For a text, a routine or a module that is not closed.
    """
    routine, kind, handler = "", "", False
    module = False
    line = 1
    for line, chunk in _chunks(source):
        rest, at = chunk, line
        while True:
            if (head := HEAD.match(rest)) is not None:
                word = head[1].upper()
                if word.startswith(("ENDPROC", "ENDFUNC", "ENDTRAP", "MODULE", "ENDMODULE")):
                    if word.startswith("END") and not (module if word == "ENDMODULE" else routine):
                        source.fail(at + _breaks(rest), f"{word} ends nothing")
                    if "MODULE" in word and routine:
                        source.fail(at + _breaks(rest), f"the end of {routine} is missing")
                    module = word.startswith("MODULE") or (module and not word.startswith("ENDMODULE"))
                    routine, kind, handler = "", "", False
                elif word.startswith(("ERROR", "BACKWARD", "UNDO")) and routine:
                    handler = True
                elif not word.startswith(("%%%", "ERROR", "BACKWARD", "UNDO")):
                    if routine:
                        source.fail(at + _breaks(rest), f"the end of {routine} is missing")
                    plain = re.sub(r"\(.*", "", head[1], flags=re.DOTALL).split()
                    routine, handler = plain[-1].lower(), False
                    kind = next(each.lower() for each in plain if each.lower() in ("proc", "func", "trap"))
                end = head.end()
            elif routine and (block := BLOCK.match(rest)) is not None:
                yield Statement(at + _breaks(rest), block[1], routine, kind, handler, True)
                end = block.end()
            else:
                break
            at += rest.count("\n", 0, end)
            rest = rest[end:]
        if rest.strip():
            yield Statement(at + _breaks(rest), " ".join(rest.split()), routine, kind, handler, False)
    if routine or module:
        source.fail(source.text.count("\n") + 1, f"the end of {routine or 'the module'} is missing")


def _breaks(text: str) -> int:
    return text[: len(text) - len(text.lstrip())].count("\n")


def _chunks(source: Source) -> Iterator[tuple[int, str]]:
    """Yield the text up to each semicolon, with the line of its first character; texts become empty."""
    line, begin, parts = 1, 1, []
    in_text = False
    for number, full in enumerate(source.text.splitlines(), start=1):
        line = number
        kept = []
        for letter in full:
            if in_text:
                in_text = letter != '"'
            elif letter == '"':
                in_text = True
                kept.append('""')
            elif letter == "!":
                break
            elif letter == ";":
                parts.append("".join(kept))
                yield begin, "".join(parts)
                kept, parts, begin = [], [], line
            else:
                kept.append(letter)
        if in_text:
            source.fail(line, "a text is not closed by a quotation mark")
        parts.append("".join(kept) + "\n")
    yield begin, "".join(parts)
