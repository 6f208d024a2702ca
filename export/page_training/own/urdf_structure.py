"""Whether a URDF file is one tree of links and joints, told by file and element before a loader reads it."""

from __future__ import annotations

from pathlib import Path
from xml.etree.ElementTree import Element, TreeBuilder
from xml.parsers import expat

import numpy as np

from page_training.own.model import require_different

SHAPES = ("box", "cylinder", "sphere", "mesh")
_EXPAND = "expand it first: `xacro FILE > expanded.urdf`"


def require_urdf(path: Path) -> None:
    """ValueError for what is no XML, not expanded, or no tree in which every joint has two links and a direction."""
    robot = _root(path)
    if robot.tag != "robot":
        raise ValueError(f"{path}: expected a <robot> around everything, got <{robot.tag}>")
    _require_expanded(robot, path)
    if not robot.get("name"):
        raise ValueError(f'{path}: expected <robot name="...">, got none')
    links = [_named(link, path) for link in robot.findall("link")]
    if not links:
        raise ValueError(f"{path}: expected one or more <link>, got none")
    require_different(links, "links", path)
    joints = robot.findall("joint")
    require_different([_named(joint, path) for joint in joints], "joints", path)
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            _require_shape(visual.find("geometry"), f"{path}: link {link.get('name')!r}: <visual>")
    _require_tree(links, [_ends(joint, links, path) for joint in joints], path)


def _root(path: Path) -> Element:
    """The file's outermost element; prefixes that nothing declares, as xacro leaves them, are part of the names."""
    builder, parser = TreeBuilder(), expat.ParserCreate()
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    try:
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        raise ValueError(f"{path}: expected XML, got {error}") from error
    return builder.close()


def _require_expanded(robot: Element, path: Path) -> None:
    for element in robot.iter():
        if element.tag.startswith("xacro:"):
            raise ValueError(f"{path}: expected a URDF, got <{element.tag}> of xacro; {_EXPAND}")
    for top in (*robot.findall("link"), *robot.findall("joint")):
        for element in top.iter():
            for name, value in element.items():
                if "${" in value or "$(" in value:
                    where = f"{top.tag} {top.get('name')!r}, <{element.tag} {name}>"
                    raise ValueError(f"{path}: {where}: expected a value, got {value} of xacro; {_EXPAND}")


def _named(element: Element, path: Path) -> str:
    name = element.get("name")
    if not name:
        raise ValueError(f'{path}: expected a name of every <{element.tag}>, got one without name="..."')
    return name


def _require_shape(geometry: Element | None, where: str) -> None:
    first = None if geometry is None else next(iter(geometry), None)
    if first is None or first.tag not in SHAPES:
        got = "none" if first is None else f"<{first.tag}>"
        raise ValueError(f"{where}: expected a <geometry> of {', '.join(SHAPES)}, got {got}; or leave the visual out")
    if first.tag == "mesh" and not first.get("filename"):
        raise ValueError(f'{where}: <mesh>: expected filename="...", got none')


def _ends(joint: Element, links: list[str], path: Path) -> tuple[str, str, str]:
    """Name, parent and child of a joint that has them, and a direction if any."""
    name, where = str(joint.get("name")), f"{path}: joint {joint.get('name')!r}"
    ends = []
    for end in ("parent", "child"):
        element = joint.find(end)
        link = None if element is None else element.get("link")
        if link not in links:
            raise ValueError(f"{where}: {end}: expected one of the links {', '.join(links)}, got {link or 'none'}")
        ends.append(link)
    for element, attribute in (("origin", "xyz"), ("origin", "rpy"), ("axis", "xyz")):
        _numbers(joint.find(element), attribute, where)
    axis = _numbers(joint.find("axis"), "xyz", where)
    if axis is not None and joint.get("type") != "fixed" and np.linalg.norm(axis) < 1e-9:
        raise ValueError(f"{where}: axis: expected a direction, got {' '.join(f'{value:g}' for value in axis)}")
    return name, ends[0], ends[1]


def _numbers(element: Element | None, attribute: str, where: str) -> list[float] | None:
    text = None if element is None else element.get(attribute)
    if element is None or text is None:
        return None
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != 3 or not np.isfinite(values).all():
        raise ValueError(f"{where}: {element.tag} {attribute}: expected three numbers, got {text!r}")
    return values


def _require_tree(links: list[str], joints: list[tuple[str, str, str]], path: Path) -> None:
    parents = {link: [(name, parent) for name, parent, child in joints if child == link] for link in links}
    for link, own in parents.items():
        if len(own) > 1:
            carriers = " and ".join(f"{parent} (joint {name})" for name, parent in own)
            raise ValueError(f"{path}: link {link!r}: expected one parent, got {carriers}")
    roots = [link for link, own in parents.items() if not own]
    if len(roots) > 1:
        raise ValueError(
            f"{path}: expected one link that no joint carries, got {', '.join(roots)}; join the others to the first "
            "by a fixed joint, or leave them out"
        )
    reached = set(roots)
    for _ in links:
        reached |= {child for _, parent, child in joints if parent in reached}
    if missed := [link for link in links if link not in reached]:
        raise ValueError(f"{path}: expected joints from one root to every link, got a ring through {', '.join(missed)}")
