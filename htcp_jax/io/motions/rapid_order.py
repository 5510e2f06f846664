"""Order in which the statements of a RAPID module run: procedures in place of their calls."""

import re

from htcp_jax.errors import InputError
from htcp_jax.io.motions.rapid_statements import Statement
from htcp_jax.io.motions.source import Source, listed

MOVES = re.compile(
    r"move|trigg[a-z]|search|arc[lc]|arcmove|paint|spot|disp[lc]|egm|ind[acdr]?move|cap[lc]|softact|eoffson|eoffsset|stepbwd"
)
INSIDE = re.compile(r"\b(?:Move(?:AbsJ|J|L|C|Ext)|Trigg[JLC]|Search[LC]|Arc[LC])\w*\s", re.IGNORECASE)
MAIN = "main"
ALONE = {"return", "exit", "stop", "break", "retry", "trynext", "raise"}  # instructions without arguments
DEEPEST = 20  # maximum number of calls within calls
MOST = 1_000_000  # maximum number of statements


def executed(source: Source, every: list[Statement]) -> list[Statement]:
    """Return the statements that run, in their order: those of a called procedure are in the place of the call.

    The program begins in `main`, or in the only procedure that moves and is not called.

    Args:
        source: The file.
        every: Statements of its modules.

    Raises:
        InputError: For moves other than MoveAbsJ, moves outside of procedures or in a procedure that does not run, and
            control flow in a procedure that runs.
    """
    bodies: dict[str, list[Statement]] = {}
    for statement in every:
        if _moves(statement, bodies) and (statement.kind != "proc" or statement.handler):
            what = "an error handler" if statement.handler else f"a {statement.kind.upper() or 'module'}"
            source.fail(statement.line, f"a move in {what}, which cannot be read")
        if statement.kind == "proc":
            bodies.setdefault(statement.routine, [])
            if not statement.handler:
                bodies[statement.routine].append(statement)
    first = {name: moves[0] for name, body in bodies.items() if (moves := [s for s in body if _moves(s, bodies)])}
    if not first:
        called = [s.text for body in bodies.values() for s in body if re.fullmatch(r"\w+", s.text)]
        others = [name for name in called if name.lower() not in bodies.keys() | ALONE]
        more = f"; it calls {listed(others)}, which it does not contain" if others else ""
        raise InputError(f"{source.file} contains no MoveAbsJ in a procedure{more}")
    begin = _begin(source, bodies, first)
    found: list[Statement] = []
    ran = _run(source, bodies, begin, found, ())
    if unused := [name for name in first if name not in ran]:
        source.fail(first[unused[0]].line, f"a move in {unused[0]}, which {begin} does not call")
    return found


def _moves(statement: Statement, procedures: dict[str, list[Statement]]) -> bool:
    """Return True if a statement moves by itself, or after a condition."""
    is_call = statement.text.lower() in procedures
    return not is_call and bool(MOVES.match(statement.word) or INSIDE.search(statement.text))


def _begin(source: Source, bodies: dict[str, list[Statement]], first: dict[str, Statement]) -> str:
    """Return the procedure in which the program begins."""
    if MAIN in bodies:
        return MAIN
    callers = {name: {s.text.lower() for s in body} & bodies.keys() for name, body in bodies.items()}
    called = set().union(*callers.values())

    def leads_to_a_move(name: str, above: tuple[str, ...] = ()) -> bool:
        return name in first or any(
            leads_to_a_move(inner, (*above, name)) for inner in callers[name] if inner not in above
        )

    begins = [name for name in bodies if name not in called and leads_to_a_move(name)]
    if len(begins) != 1:
        names = listed(begins or [*first])
        line = first[begins[1]].line if len(begins) > 1 and begins[1] in first else next(iter(first.values())).line
        source.fail(line, f"several procedures move: {names}; valid: one, or a main that calls them")
    return begins[0]


def _run(
    source: Source, bodies: dict[str, list[Statement]], name: str, found: list[Statement], above: tuple[str, ...]
) -> set[str]:
    """Append the statements of a procedure and of those that it calls; return the names of all of them."""
    ran = {name}
    body = bodies[name]
    for k, statement in enumerate(body):
        if statement.flow:
            word = statement.text.split()[0].upper()
            source.fail(statement.line, f"{word} controls the flow, which cannot be read")
        called = statement.text.lower()
        if called in bodies:
            if called in (*above, name) or len(above) > DEEPEST:
                source.fail(statement.line, f"{called} calls itself, which cannot be read")
            ran |= _run(source, bodies, called, found, (*above, name))
            continue
        if _moves(statement, bodies) and statement.word != "moveabsj":
            word = statement.text.split()[0]
            source.fail(statement.line, f"{word} moves in a way that cannot be read; only MoveAbsJ is")
        is_last = k == len(body) - 1
        if (statement.word == "return" and not is_last) or (statement.word == "exit" and (above or not is_last)):
            source.fail(
                statement.line, f"{statement.text.split()[0]} before the end controls the flow, which cannot be read"
            )
        found.append(statement)
        if len(found) > MOST:
            source.fail(statement.line, f"more than {MOST:,} instructions")
    return ran
