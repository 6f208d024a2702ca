"""Model files that cannot be used are refused in a sentence that names what is wrong with them."""

from __future__ import annotations

from pathlib import Path

import pytest

from own_models import BOLT, JOINT_FILE, URDF, beside
from page_training.cli import main
from page_training.own.joint_file import read_joint_file
from page_training.own.urdf import read_urdf


@pytest.mark.parametrize(
    ("old", "new", "fixed", "word"),
    [
        ("", "", ["lid"], "expected joints of hinge, slide, got lid"),
        ('name = "slide"', 'name = "hinge"', [], "got hinge more than once"),
        ('child = "bolt"', 'child = "door"', ["slide"], "part 'door': .*got hinge, slide"),
        ('parent = "door"', 'parent = "bolt"', ["slide"], "a ring through bolt"),
        ('child = "bolt"', 'child = "frame"', ["slide"], "part 'frame': expected no joint"),
    ],
)
def test_joints_that_cannot_be_told_or_fixed_are_refused(
    old: str, new: str, fixed: list[str], word: str, cupboard: Path, tmp_path: Path
) -> None:
    path = beside(cupboard, tmp_path, JOINT_FILE + BOLT.replace(old, new, 1))
    with pytest.raises(ValueError, match=word):
        read_joint_file(path, fixed)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["box", "{crane}"], "built-in"),
        (["my-crane", "{crane}"], "letters, digits and underscores"),
        (["c", "{crane}", "--fix", "elbow"], "got elbow"),
        (["c", "nothing.urdf"], "got nothing there"),
        (["c", "{folder}/meshes/mast.stl"], "expected a .urdf file, or a .toml"),
        (["c", "{crane}", "--symmetric", "boom", "w", "2"], "expected x, y or z"),
        (["c", "{crane}", "--symmetric", "jib", "x", "2"], "expected parts of foot"),
        (["c", "{crane}", "--rest", "sideways"], "stand, any"),
        (["c", "{crane}", "--scale-sigma", "2"], "0 to 0.2"),
        (["c", "{crane}", "--fix", "turn", "lift", "reach"], "one rigid object"),
    ],
)
def test_what_cannot_be_made_is_refused_in_a_sentence(
    arguments: list[str], word: str, crane: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    given = [argument.format(crane=crane, folder=crane.parent) for argument in arguments]
    assert main(["from-urdf", *given]) == 2
    assert word in capsys.readouterr().err
    assert not (tmp_path / "export").exists()


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('type="continuous"', 'type="floating"', "--fix turn takes it for fixed"),
        ("meshes/slide.obj", "meshes/gone.obj", "expected the mesh meshes/gone.obj"),
        (
            '<geometry><cylinder radius="0.02" length="0.2"/>\n    </geometry>',
            "",
            "'boom': <visual>: .*got none",
        ),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "joint 'turn': axis: expected a direction"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0"/>', "joint 'turn': axis xyz: expected three numbers, got '0 0'"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 ${up}"/>', "joint 'turn', <axis xyz>: .*of xacro; expand"),
        ('<link name="foot">', '<xacro:leg/><link name="foot">', "<xacro:leg> of xacro; expand"),
        ('<child link="boom"/>', '<child link="jib"/>', "joint 'lift': child: expected one of the links .*, got jib"),
        ('<child link="boom"/>', "", "joint 'lift': child: .*got none"),
        (
            '<child link="lamp"/>',
            '<child link="boom"/>',
            "'boom': expected one parent, got mast .joint screw. and",
        ),
        ('<link name="foot">', '<link name="hook"/><link name="foot">', "that no joint carries, got hook, foot"),
        ('<parent link="foot"/>', '<parent link="slide"/>', "a ring through mast"),
        ('<link name="lamp">', '<link name="foot">', "got foot more than once"),
        ('<sphere radius="0.03"/>', '<capsule radius="0.03"/>', "link 'lamp': <visual>: .*got <capsule>"),
        ('mesh filename="package://crane/meshes/mast.stl"', "mesh", "link 'mast': <visual>: <mesh>: expected filename"),
        ("</robot>", "", "crane.urdf: expected XML, got no element found: line"),
        ('<robot name="crane">', "<robot>", "expected <robot name"),
        ('lower="0" upper="0.1"', 'lower="0.1" upper="0.1"', "low < high"),
        ('joint name="reach"', 'joint name="lift"', "got lift more than once"),
    ],
)
def test_a_urdf_that_cannot_be_used_says_why(old: str, new: str, word: str, crane: Path, tmp_path: Path) -> None:
    assert old in URDF
    (tmp_path / "meshes").mkdir()
    for name in ("mast.stl", "slide.obj"):
        (tmp_path / "meshes" / name).write_bytes((crane.parent / "meshes" / name).read_bytes())
    path = tmp_path / "crane.urdf"
    path.write_text(URDF.replace(old, new))
    with pytest.raises(ValueError, match=word):
        read_urdf(path)


@pytest.mark.parametrize("alone", [True, False])
@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("mast.stl", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "got a Git-LFS pointer"),
        ("mast.dae", b"version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n", "got a Git-LFS pointer"),
        ("mast.stl", bytes(range(256)), "expected triangles, got none"),
        ("mast.stl", None, "got nothing there"),
        ("mast.obj", b"", "expected triangles, got none"),
        ("mast.glb", b"no such thing", "a mesh that trimesh can load"),
    ],
)
def test_every_mesh_of_a_urdf_is_read_or_named(
    name: str, content: bytes | None, word: str, alone: bool, crane: Path, tmp_path: Path
) -> None:
    (tmp_path / "meshes").mkdir()
    for mesh in ("mast.stl", "slide.obj"):
        (tmp_path / "meshes" / mesh).write_bytes((crane.parent / "meshes" / mesh).read_bytes())
    sound = '<visual><geometry><box size="0.1 0.1 0.1"/></geometry></visual>'
    text = URDF.replace("mast.stl", name)
    (tmp_path / "crane.urdf").write_text(
        text if alone else text.replace('<link name="mast">', f'<link name="mast">{sound}')
    )
    (tmp_path / "meshes/mast.stl").unlink()
    if content is not None:
        (tmp_path / "meshes" / name).write_bytes(content)
    with pytest.raises(ValueError, match=word) as refused:
        read_urdf(tmp_path / "crane.urdf")
    assert f"meshes/{name}" in str(refused.value)
    assert "--fix" not in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "word"),
    [
        ('unit = "mm"', 'unit = "furlong"', "expected one of m, cm, mm, in"),
        ('kind = "revolute"', 'kind = "screw"', "expected revolute or prismatic"),
        ('parent = "frame"', 'parent = "wall"', "expected one of frame, door"),
        ("axis = [0, 0, 2]", "axis = [0, 0]", "expected 3 numbers"),
        ("axis = [0, 0, 2]", "axis = [0, 0, 0]", "expected a direction"),
        ("limits_deg = [0, 110]", "limits_deg = [110, 0]", "low < high"),
        ("limits_deg = [0, 110]", "limits_m = [0, 1]", "missing"),
        ('mesh = "frame.stl"', 'mesh = "gone.stl"', "got nothing there"),
        ('mesh = "frame.stl"', "mesh = 5", "part 'frame': mesh: expected a file's name or a list of them, got 5"),
        ('mesh = "frame.stl"', "mesh = []", r"got \[\]"),
        ('name = "door"', 'name = "frame"', "different names"),
        ("[[joint]]", "[joint]", r"\[\[joint\]\]"),
        ('unit = "mm"', 'unit = mm"', "expected TOML"),
    ],
)
def test_a_joint_file_that_cannot_be_used_says_why(
    old: str, new: str, word: str, cupboard: Path, tmp_path: Path
) -> None:
    assert old in JOINT_FILE
    for name in ("frame.stl", "door.ply", "knob.glb"):
        (tmp_path / name).write_bytes((cupboard.parent / name).read_bytes())
    path = tmp_path / "cupboard.toml"
    path.write_text(JOINT_FILE.replace(old, new, 1))
    with pytest.raises(ValueError, match=word):
        read_joint_file(path)
