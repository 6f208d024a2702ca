"""The command of `page-train` that makes a category of the user's own models."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

# The side of a part, and of a whole object with all joints at 0, beyond which the unit is more likely to be wrong.
LARGE_PART_M = 4.0
SMALL_OBJECT_M = 0.02


def add_to(commands: Any) -> None:
    """Its parser, on what argparse's add_subparsers gave."""
    text = "make a category of your own from URDF files, or from meshes with a joint file (.toml)"
    parser = commands.add_parser("from-urdf", help=text, description=text)
    parser.add_argument("name", help="of the category: letters, digits, underscores")
    parser.add_argument("files", type=Path, nargs="+", metavar="FILE", help="one object each, .urdf or .toml")
    for split in ("validation", "test"):
        parser.add_argument(
            f"--{split}", type=Path, nargs="+", default=[], metavar="FILE",
            help=f"objects for the {split} split alone, which training never sees (default: new scenes of FILE...)",
        )  # fmt: skip
    parser.add_argument("--fix", nargs="+", default=[], metavar="JOINT", help="take these joints for fixed, at 0")
    parser.add_argument("--rest", default="stand", help="stand (on the root's -z side) or any (default: %(default)s)")
    parser.add_argument("--scale-sigma", type=float, help="by which sizes vary, a share (default: 0.02)")
    parser.add_argument(
        "--symmetric", nargs=3, action="append", default=[], metavar=("PART", "AXIS", "FOLD"),
        help="a part that looks the same after a turn about its x, y or z: FOLD 2 for half a turn, 0 for any",
    )  # fmt: skip
    parser.set_defaults(run_command=_from_urdf)


def _from_urdf(options: argparse.Namespace) -> None:
    from page_training.categories import BUILT_IN, own_folder
    from page_training.own.category import SCALE_SIGMA, OwnCategory, own_category
    from page_training.own.files import CATEGORY_FILE, write_own
    from page_training.own.joint_file import read_joint_file
    from page_training.own.model import OwnModel
    from page_training.own.urdf import read_urdf
    from page_training.terminal import progress_bar

    if options.name in BUILT_IN:
        raise ValueError(f"name: expected another than those of the built-in categories, got {options.name!r}")
    given = {"train": options.files, "validation": options.validation, "test": options.test}
    models: dict[str, list[OwnModel]] = {split: [] for split in given}
    with progress_bar() as progress:
        task = progress.add_task("reading", total=sum(map(len, given.values())))
        for split, path in ((split, path) for split, paths in given.items() for path in paths):
            if path.suffix == ".urdf":
                models[split].append(read_urdf(path, options.fix))
            elif path.suffix == ".toml":
                models[split].append(read_joint_file(path, options.fix))
            else:
                raise ValueError(f"{path}: expected a .urdf file, or a .toml file that names meshes and joints")
            progress.advance(task)
    # Before what may refuse them: a wrong unit is seen from these.
    for split, paths in given.items():
        for path, model in zip(paths, models[split], strict=True):
            _tell_sizes(path, model)
    own: OwnCategory = own_category(
        options.name,
        models.pop("train"),
        rest=options.rest,
        scale_sigma=SCALE_SIGMA if options.scale_sigma is None else options.scale_sigma,
        symmetries=[_symmetry(*words) for words in options.symmetric],
        unseen=models,
    )
    folder = own_folder(options.name)
    replaced = (folder / CATEGORY_FILE).is_file()
    write_own(own, folder)
    _tell_joints(own.category)
    _tell_splits(own)
    if own.category.focused:
        print("thin: parts fill little of a region; the network will run twice, the second time where it saw them")
    if replaced:
        print(f"replaces the category {options.name} there was: what differs from it needs page-train scenes again")
    print(folder)


def _symmetry(part: str, axis: str, fold: str) -> Any:
    from page_runtime.symmetry import Symmetry

    if axis not in ("x", "y", "z") or not fold.isdigit():
        raise ValueError(f"--symmetric {part}: expected x, y or z and a whole number, got {axis} {fold}")
    x, y, z = (float(axis == name) for name in "xyz")
    return part, Symmetry((x, y, z), int(fold))


def _tell_sizes(path: Path, model: Any) -> None:
    """How large the parts of a file are, what may be too small to be seen, and what no object of this kind measures."""
    sizes = [np.ptp(part.surface.vertices, axis=0) for part in model.parts]
    largest = max(float(np.linalg.norm(size)) for size in sizes)
    for k, (part, size) in enumerate(zip(model.parts, sizes, strict=True)):
        said = f"{path.name}: part {part.name}: {' x '.join(f'{1e3 * side:.0f}' for side in size)} mm"
        small = float(np.linalg.norm(size)) < 0.12 * largest
        carrier = next((joint.name for joint in model.joints if joint.child == k), None)
        print(said + (f"; small: --fix {carrier} joins it to what carries it" if small and carrier else ""))
    whole = float(np.ptp(np.concatenate([part.surface.vertices for part in model.parts]), axis=0).max())
    part_m = max(float(size.max()) for size in sizes)
    if part_m > LARGE_PART_M:
        print(f"{path.name}: a part measures {part_m:.3g} m: is the unit right? {_way_out(path, 'mm')}")
    elif whole < SMALL_OBJECT_M:
        print(f"{path.name}: all of it measures {1e3 * whole:.3g} mm: is the unit right? {_way_out(path, 'm')}")


def _tell_splits(own: Any) -> None:
    """Which objects the figures of a split will be of."""
    for split in ("validation", "test"):
        objects = len(own.models_of(split))
        told = f"objects that training never sees, {objects} of them"
        if not objects:
            told = "new scenes of the objects trained on"
        print(f"split {split}: {told}")


def _way_out(path: Path, unit: str) -> str:
    """What to write where lengths are in a unit other than the file says."""
    if path.suffix == ".toml":
        return f'Where lengths are in {unit}, say so: unit = "{unit}"'
    scale = {"mm": "0.001 0.001 0.001", "m": "1 1 1"}[unit]
    return f'Where meshes are in {unit}, say so in every <mesh>: scale="{scale}"; all else in a URDF is in metres'


def _tell_joints(category: Any) -> None:
    for joint in category.joints:
        unit, factor = ("m", 1.0) if joint.kind == "prismatic" else ("deg", float(np.degrees(1.0)))
        low, high = (factor * limit for limit in joint.limits)
        ends = f"{category.parts[joint.parent].name} to {category.parts[joint.child].name}"
        print(f"joint {joint.name}: {joint.kind}, {ends}, {low:.3g} to {high:.3g} {unit}")
