"""Constraints between the joints or bodies of an MJCF file, which are not planned, as remarks on them."""

from xml.etree.ElementTree import Element

from htcp_jax.io.robots import remarks

CLOSING = "connect", "weld"


def joint_remarks(root: Element) -> dict[str, list[str]]:
    """Return remarks on the joints that a <joint> in <equality> couples to another one or holds, by their names."""
    found: dict[str, list[str]] = {}
    for each in _active(root, ("joint",)):
        other = each.get("joint2")
        value = (each.get("polycoef", "0").split() or ["0"])[0]
        said = remarks.HELD + value if other is None else remarks.COUPLED + other
        found.setdefault(each.get("joint1", ""), []).append(said)
    return found


def body_remarks(root: Element) -> dict[str, list[str]]:
    """Return remarks on the bodies that a <connect> or <weld> ties to another one, by their names."""
    body_of = {site.get("name"): body.get("name", "") for body in root.iter("body") for site in body.findall("site")}
    found: dict[str, list[str]] = {}
    for each in _active(root, CLOSING):
        ends = [each.get(f"body{k}") or body_of.get(each.get(f"site{k}")) or "world" for k in (1, 2)]
        for name in ends:
            found.setdefault(name, []).append(f"<{each.tag}> of {' and '.join(ends)}")
    return found


def _active(root: Element, tags: tuple[str, ...]) -> list[Element]:
    rows = [each for equality in root.findall("equality") for each in equality if each.tag in tags]
    return [each for each in rows if each.get("active", "true") != "false"]
