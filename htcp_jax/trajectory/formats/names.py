"""Names of programs and tools that a controller's language accepts.

KRL_WORDS follows the keywords of the KRL grammar in github.com/antlr/grammars-v4, and SPTP and SLIN of KSS 8. The other
lists follow ABB's Technical reference manual, RAPID Overview, 3HAC050947 (reserved words), and Universal Robots'
The URScript Programming Language (keywords), and were compared with the syntax files rapid-for-vim and urscript-mode on
GitHub. A word that only a later version of a language reserves is not refused.
Other formats do not contain names, or only quoted ones, and INFORM (jbi) reserves no job names.
"""

import re

from htcp_jax.errors import InputError

RAPID_WORDS = frozenset(
    "alias and backward case connect const default div do else elseif endfor endfunc endif endmodule endproc endrecord "
    "endtest endtrap endwhile error exit false for from func goto if inout local mod module nostepin not noview or "
    "pers proc raise readonly record retry return step sysmodule task test then to trap true trynext undo var viewonly "
    "while with xor".split()
)
KRL_WORDS = frozenset(
    "and anin anout b_and b_exor b_not b_or bool brake c_dis c_ori c_ptp c_vel case char circ circ_rel const "
    "continue decl def default deffct do else end enddat endfct endfor endif endloop endswitch endwhile enum exit exor "
    "ext extfct false for global goto halt if import int interrupt is lin lin_rel loop not or ptp ptp_rel public "
    "real repeat return sec signal slin sptp struc switch then to trigger true until wait when while".split()
)
URSCRIPT_WORDS = frozenset(
    "and break continue def elif else end enter_critical exit_critical False global halt if join kill local not or "
    "return run sec thread True while xor".split()
)


def comment(text: str) -> str:
    """Return a text as one line of ASCII characters."""
    return " ".join(text.split()).encode("ascii", "replace").decode()


def output_number(format: str, output: int | str) -> int:
    """Return the number of an output in `program.process`.

    Raises:
        InputError: If the job states its name, which the format does not contain.
    """
    if isinstance(output, str):
        raise InputError(f"{format}: program.process names the output {output!r}; valid: its number")
    return output


def check_name(what: str, name: str, pattern: re.Pattern, rule: str, reserved: frozenset[str] = frozenset()) -> None:
    """Check a name in a program.

    Args:
        what: The format and the kind of name, for messages, such as "rapid: procedure name".
        name: The name.
        pattern: Pattern of valid names.
        rule: The pattern as text, for messages.
        reserved: Words of the language, and names that the program uses otherwise; if a language ignores case, in lower
            case.

    Raises:
        InputError: If the name does not match the pattern, or is reserved.
    """
    if not pattern.fullmatch(name):
        raise InputError(f"{what} {name!r} is not valid; valid: {rule}")
    if {name, name.lower()} & reserved:
        text = f"{what} {name!r} is a word of the language, or used in the program"
        raise InputError(f"{text}; valid: another word of {rule}")
