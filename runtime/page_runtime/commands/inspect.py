"""page-runtime inspect: what a bundle says about itself."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

from page_runtime.bundle import PREPROCESSING, BundleMetadata
from page_runtime.bundle_figures import PartFigures
from page_runtime.bundle_file import read_metadata
from page_runtime.category import Joint
from page_runtime.confidence import FEATURES
from page_runtime.symmetry import Symmetry


def inspect(bundle: Path, *, as_json: bool) -> None:
    """Write the bundle's metadata to standard output, for people or as the JSON document it is. Nothing of it is run,
    and it may be one for several objects at once."""
    metadata = read_metadata(bundle)
    document = json.dumps(json.loads(metadata.to_json()), indent=1) + "\n"
    sys.stdout.write(document if as_json else readable(metadata, bundle))


def readable(metadata: BundleMetadata, bundle: Path) -> str:
    """The metadata in words, all of it."""
    category = metadata.category
    lines = [
        f"{bundle}: {bundle.stat().st_size / 1e6:.2f} MB",
        f"category       {category.name}",
        f"network        {metadata.num_points} points, {metadata.image_size}x{metadata.image_size} px, "
        f"ONNX opset {metadata.opset}",
        f"scoring        {category.num_voted} of {category.num_keypoints} keypoints of a part are voted, "
        f"voxels of {metadata.voxel_m * 1e3:g} mm",
        f"region         points within {category.region_radius_m:g} m of its middle"
        + (", then those where a first look saw the object" if category.focused else ""),
        f"mirror         {_mirror(metadata)}",
        "input",
        *(f"  {name:<12} {said}" for name, said in PREPROCESSING.items()),
    ]
    for k, part in enumerate(category.parts):
        low, high = part.diagonal_range_m
        lines += [
            f"part {k}         {part.name}",
            f"  frame        {part.frame}",
            *([] if part.symmetry is None else [f"  symmetry     {_turns(part.symmetry)} change nothing"]),
            f"  box          {_numbers(part.extents_unit)} of its diagonal along x, y, z on average; "
            f"diagonal {low:g} to {high:g} m",
            "  keypoints    in units of the diagonal, canonical frame",
            *(
                f"    {i}{' voted' if i < category.num_voted else '      '}    {_numbers(keypoint)}"
                for i, keypoint in enumerate(part.keypoints_unit)
            ),
            "  template     none: poses are from radii alone"
            if part.template is None
            else f"  template     {len(part.template.points_unit)} points with normals",
        ]
    for joint in category.joints:
        parent, child = category.parts[joint.parent].name, category.parts[joint.child].name
        lines.append(
            f"joint          {joint.name}: {child} against {parent}, "
            f"{joint.kind} {'along' if joint.kind == 'prismatic' else 'about'} {_numbers(np.array(joint.axis))} "
            f"of {parent}, state {_limits(joint)}, 0 where both frames are parallel"
        )
        if joint.geometry is not None:
            place = joint.geometry
            on_parent, on_child, spread_parent, spread_child = (
                _numbers(np.array(one))
                for one in (place.pivot_parent, place.pivot_child, place.sigma_parent, place.sigma_child)
            )
            lines += [
                f"  place        {on_parent} of {parent}'s box, {on_child} of {child}'s, in its sides from the middle; "
                f"spread over instances {spread_parent} and {spread_child} diagonals",
                f"  sizes        {child} {np.exp(place.log_size_ratio):.2f} times {parent}'s diagonal, "
                f"times or over {np.exp(place.log_size_sigma):.2f}",
            ]
    if category.interchange is not None:
        renamed = ", ".join(
            f"{part.name} as {category.parts[other].name}"
            for part, other in zip(category.parts, category.interchange.parts, strict=True)
        )
        axis = _numbers(np.array(category.interchange.axis))
        lines.append(f"interchange    the same object, half a turn about {axis} of every part on: {renamed}")
    if metadata.confidence is None:
        lines.append("confidence     not calibrated: the share of radii that agree with the pose")
    else:
        weights = zip(FEATURES, metadata.confidence.weights, strict=True)
        lines += [
            "confidence     probability of 5 deg and 5 cm, calibrated; weights of its signs:",
            "  " + ", ".join(f"{name} {weight:.3g}" for name, weight in weights),
        ]
    lines += ["figures", *map(_figures, metadata.figures)] if metadata.figures else ["figures        not measured"]
    lines += ["provenance", *(f"  {name:<12} {json.dumps(value)}" for name, value in metadata.provenance.items())]
    return "\n".join(lines) + "\n"


def _mirror(metadata: BundleMetadata) -> str:
    mirror = metadata.category.mirror
    if not metadata.mirrored or mirror is None:
        return "no"
    names = [part.name for part in metadata.category.parts]
    moved = [f"{names[k]} as {names[other]}" for k, other in enumerate(mirror.order(len(names))) if other != k]
    exchanged = f", which shows {', '.join(moved)}" if moved else ""
    return f"trained on mirror images too: along {'xyz'[mirror.axis]} of every part{exchanged}"


def _figures(one: PartFigures) -> str:
    def pair(values: tuple[float | None, float | None], times: float) -> str:
        return " / ".join("-" if value is None else f"{times * value:.1f}" for value in values)

    failed = "-" if one.failure_rate is None else f"{100 * one.failure_rate:.1f}"
    return (
        f"  {one.part}: {pair(one.rotation_deg, 1.0)} deg, {pair(one.translation_m, 1e3)} mm, "
        f"{pair(one.translation_share, 100.0)} % of the diagonal (mean / median), {failed} % failures; "
        f"{one.data}, {one.instances} objects"
    )


def _turns(symmetry: Symmetry) -> str:
    turns = "all turns" if symmetry.fold == 0 else f"turns by {360 / symmetry.fold:g} deg"
    return f"{turns} about {_numbers(np.array(symmetry.axis))}"


def _numbers(values: np.ndarray) -> str:
    return "(" + ", ".join(f"{value:.3f}" for value in values) + ")"


def _limits(joint: Joint) -> str:
    low, high = joint.limits
    if joint.kind == "prismatic":
        return f"{low:g} to {high:g} m"
    return f"{np.degrees(low):g} to {np.degrees(high):g} deg"
