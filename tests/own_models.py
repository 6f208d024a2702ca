"""A crane as a URDF file and a cupboard as a joint file, with their meshes."""

from __future__ import annotations

from pathlib import Path

import trimesh
from trimesh.visual import ColorVisuals

URDF = """<robot name="crane">
  <material name="orange"><color rgba="0.9 0.5 0.1 1"/></material>
  <link name="foot"><visual><geometry><box size="0.3 0.2 0.1"/></geometry><material name="orange"/></visual></link>
  <link name="mast"><visual><origin xyz="0 0 0.15"/><geometry><mesh filename="package://crane/meshes/mast.stl"/>
    </geometry></visual></link>
  <link name="lamp"><visual><geometry><sphere radius="0.03"/></geometry></visual></link>
  <link name="boom"><visual><origin xyz="0.1 0 0" rpy="0 1.5707963 0"/><geometry><cylinder radius="0.02" length="0.2"/>
    </geometry></visual></link>
  <link name="slide"><visual><geometry><mesh filename="meshes/slide.obj" scale="0.001 0.001 0.001"/></geometry></visual>
  </link>
  <joint name="turn" type="continuous"><parent link="foot"/><child link="mast"/>
    <origin xyz="0.02 0.01 0.05" rpy="0 0 0.4"/><axis xyz="0 0 1"/></joint>
  <joint name="screw" type="fixed"><parent link="mast"/><child link="lamp"/><origin xyz="0 0.03 0.31"/></joint>
  <joint name="lift" type="revolute"><parent link="mast"/><child link="boom"/>
    <origin xyz="0 0 0.3" rpy="0.1 0.2 0.3"/><axis xyz="0 -1 0.2"/>
    <limit lower="-0.2" upper="1.2" effort="1" velocity="1"/></joint>
  <joint name="reach" type="prismatic"><parent link="boom"/><child link="slide"/>
    <origin xyz="0.2 0 0" rpy="0 0 0.5"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
</robot>"""
JOINT_FILE = """unit = "mm"
[[part]]
name = "frame"
mesh = "frame.stl"
[[part]]
name = "door"
mesh = ["door.ply", "knob.glb"]
[[joint]]
name = "hinge"
parent = "frame"
child = "door"
kind = "revolute"
axis = [0, 0, 2]
point = [-200, 0, 0]
limits_deg = [0, 110]
"""
BOLT = """[[part]]
name = "bolt"
mesh = "knob.glb"
[[joint]]
name = "slide"
parent = "door"
child = "bolt"
kind = "prismatic"
axis = [1, 0, 0]
limits_m = [0, 0.05]
"""


def write_crane(folder: Path) -> Path:
    """Four moving parts and a lamp that is fixed to one."""
    (folder / "meshes").mkdir()
    trimesh.creation.box((0.05, 0.04, 0.3)).export(folder / "meshes/mast.stl")
    trimesh.creation.uv_sphere(radius=25.0, count=[120, 120]).export(folder / "meshes/slide.obj")
    (folder / "crane.urdf").write_text(URDF)
    return folder / "crane.urdf"


def write_cupboard(folder: Path) -> Path:
    """Its meshes are in millimetres."""
    boxes = {"frame.stl": ((400, 300, 500), (0, 150, 250)), "door.ply": ((396, 20, 490), (0, -10, 250))}
    for name, (size, middle) in boxes.items():
        box = trimesh.creation.box(size)
        box.apply_translation(middle)
        box.export(folder / name)
    knob = trimesh.creation.icosphere(radius=15)
    knob.apply_translation((150, -30, 250))
    knob.visual = ColorVisuals(knob, face_colors=(255, 0, 0, 255))
    knob.export(folder / "knob.glb")
    (folder / "cupboard.toml").write_text(JOINT_FILE)
    return folder / "cupboard.toml"


def beside(files: Path, folder: Path, text: str) -> Path:
    """The joint file of this text in a folder, with the cupboard's meshes."""
    for name in ("frame.stl", "door.ply", "knob.glb"):
        (folder / name).write_bytes((files.parent / name).read_bytes())
    path = folder / "cupboard.toml"
    path.write_text(text)
    return path
