"""A toy box seen by an exact camera, and a bundle whose network knows the answer.

Two boxes, base and lid, stand on a table and are rendered by intersecting each pixel's ray with them, so that depth,
masks and poses agree exactly. `write_oracle_bundle` writes a real .onnx file of the runtime's signature that computes
labels and radii from the true poses: what the runtime then gets wrong is the runtime's own.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
from numpy.typing import NDArray
from onnx import TensorProto, helper, numpy_helper

from page_export.bundle_writer import bundle_bytes
from page_runtime.bundle import BundleMetadata
from page_runtime.camera import Camera
from page_runtime.category import Category, Joint, Part
from page_runtime.frame import RgbdFrame
from page_runtime.geometry import Array, apply, invert, rotation_about, transform_from
from page_runtime.neighbours import ANSWERED, GROUP_SIZE, INTERPOLATION_SIZE, LEVELS
from page_runtime.recorded import Instance, PartTruth, RecordedFrame
from page_runtime.recording import RecordingWriter
from page_runtime.sampling import Region, sample_region
from page_runtime.signature import INPUT_NAMES, OUTPUT_NAMES
from synthetic_parts import box_template

# Frames of the long recording: two of the pieces that validation shares out.
LONG = 36
IMAGE_SIZE = 224
STATE_RAD = 1.9
EXTENTS_M = (np.array([0.22, 0.10, 0.05]), np.array([0.22, 0.10, 0.02]))
KEYPOINTS_UNIT = 0.35 * np.array([[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1], [0, 0, 1.5], [0, 0, -1.5]])
CATEGORY = Category(
    name="box",
    parts=tuple(
        Part(
            name,
            f"origin: centre of the {name}'s box",
            KEYPOINTS_UNIT,
            e / np.linalg.norm(e),
            (0.09, 0.55),
            box_template(e / np.linalg.norm(e)),
        )
        for name, e in zip(("base", "lid"), EXTENTS_M, strict=True)
    ),
    joints=(Joint("hinge", 0, 1, "revolute", (-1.0, 0.0, 0.0), (0.0, float(np.pi))),),
    num_voted=3,
    region_radius_m=0.42,
)


def toy_camera(width: int = 320, height: int = 240) -> Camera:
    """A camera with its principal point in the middle."""
    focal = 1.1 * width
    return Camera(np.array([[focal, 0, (width - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1]]), width, height)


def part_poses(distance_m: float = 0.7, yaw_rad: float = 0.5) -> tuple[Array, Array]:
    """T_camera_part (4,4) of base and lid, the camera looking down at them."""
    flip = np.diag([1.0, -1.0, -1.0])  # object z up towards the camera
    R = rotation_about(np.array([1.0, 0, 0]), -0.9) @ flip @ rotation_about(np.array([0, 0, 1.0]), yaw_rad)
    T_camera_base = transform_from(R, np.array([0.01, 0.03, distance_m]))
    hinge_base = np.array([0, EXTENTS_M[0][1] / 2, EXTENTS_M[0][2] / 2])
    hinge_lid = np.array([0, EXTENTS_M[1][1] / 2, -EXTENTS_M[1][2] / 2])
    R_base_lid = rotation_about(np.array([-1.0, 0, 0]), STATE_RAD)
    return T_camera_base, T_camera_base @ transform_from(R_base_lid, hinge_base - R_base_lid @ hinge_lid)


def ray_depth(rays: Array, T_camera_part: Array, extents_m: Array) -> Array:
    """z-depth (...,) at which rays (..., 3) with z = 1 enter the box, inf where they miss it."""
    origin = invert(T_camera_part)[:3, 3]
    directions = rays @ T_camera_part[:3, :3]
    with np.errstate(divide="ignore"):
        one, other = (-extents_m / 2 - origin) / directions, (extents_m / 2 - origin) / directions
    enter, leave = np.minimum(one, other).max(axis=-1), np.maximum(one, other).min(axis=-1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


def toy_frame(
    camera: Camera | None = None, *, index: int = 0
) -> tuple[RecordedFrame, tuple[NDArray[np.bool_], NDArray[np.bool_]]]:
    """The toy on its table with truth, and the masks of base and lid (H,W)."""
    camera = camera or toy_camera()
    rows, columns = np.mgrid[: camera.height, : camera.width]
    rays = camera.rays(np.stack([columns, rows], axis=-1).astype(float))
    poses = part_poses()
    table = poses[0] @ transform_from(np.eye(3), np.array([0, 0, -EXTENTS_M[0][2] / 2 - 0.01]))
    depths = [ray_depth(rays, T, e) for T, e in zip(poses, EXTENTS_M, strict=True)]
    depths.append(ray_depth(rays, table, np.array([4.0, 4.0, 0.02])))
    depth = np.min(depths, axis=0)
    label = np.argmin(depths, axis=0)
    depth = np.where(np.isfinite(depth), depth, 0.0)
    masks = label == 0, label == 1
    color = np.array([[200, 120, 40], [40, 160, 200], [90, 90, 90]], np.uint8)[label]
    seen = masks[0] | masks[1]
    v, u = np.nonzero(seen)
    region = int(u.min()), int(v.min()), int(np.ptp(u)) + 1, int(np.ptp(v)) + 1
    shares = [float(mask.sum() / np.isfinite(d).sum()) for mask, d in zip(masks, depths, strict=False)]
    truths = tuple(
        PartTruth(name, T, extents, share, state)
        for name, T, extents, share, state in zip(
            ("base", "lid"), poses, EXTENTS_M, shares, (None, STATE_RAD), strict=True
        )
    )
    frame = RgbdFrame(color, depth.astype(np.float32), camera, timestamp_s=index / 30, index=index)
    return RecordedFrame(frame, (Instance(region, truths),)), masks


def without_depth(recorded: RecordedFrame) -> RecordedFrame:
    """The same frame with not one depth reading."""
    frame = recorded.frame
    blind = RgbdFrame(frame.color, np.zeros_like(frame.depth_m), frame.camera, frame.timestamp_s, frame.index)
    return RecordedFrame(blind, recorded.instances)


def write_toy_recording(path: Path, *, frames: int = 3, blind: tuple[int, ...] = ()) -> Path:
    """A recording of the toy; frames in `blind` have no depth."""
    recorded, masks = toy_frame()
    with RecordingWriter(path, category="box", part_names=("base", "lid"), depth_unit_mm=0.1) as writer:
        for i in range(frames):
            writer.write(without_depth(recorded) if i in blind else recorded, masks=(masks,))
    return path


def write_long_recording(path: Path) -> Path:
    """LONG frames that differ in their noise, every twentieth blind."""
    rng = np.random.default_rng(0)
    recorded, masks = toy_frame(toy_camera(160, 120))
    with RecordingWriter(path, category="box", part_names=("base", "lid"), depth_unit_mm=0.1) as writer:
        for index in range(LONG):
            depth_m = recorded.frame.depth_m + rng.normal(0, 0.001, recorded.frame.depth_m.shape).astype(np.float32)
            if index % 20 == 7:
                depth_m[:] = 0
            frame = RgbdFrame(recorded.frame.color, depth_m, recorded.frame.camera, index / 30, index)
            writer.write(RecordedFrame(frame, recorded.instances), masks=[masks])
    return path


def write_oracle_bundle(
    path: Path, frame: RgbdFrame, region: Region, poses: tuple[Array, Array], category: Category = CATEGORY
) -> Path:
    """A bundle that answers exactly for every frame whose depth in `region` is that of `frame`.

    Labels: inside a part's box grown by 2 mm; radii: distances to the point's own part's keypoints.
    """
    unit = category.region_radius_m
    sample = sample_region(frame, region, image_size=IMAGE_SIZE, num_points=LEVELS[0], radius_m=unit)
    assert not isinstance(sample, str)
    center = sample.center_camera.astype(float)
    nodes, constants = [], []

    def constant(name: str, value: object, dtype: type = np.float32) -> str:
        constants.append(numpy_helper.from_array(np.asarray(value, dtype=dtype), name))
        return name

    def node(kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    count, voted = category.num_keypoints, category.num_voted
    ratios, radii, sides = [], [], []
    for k, (T, extents) in enumerate(zip(poses, EXTENTS_M, strict=True)):
        R, t = T[:3, :3], (T[:3, 3] - center) / unit
        local = node("MatMul", [node("Sub", ["points", constant(f"t{k}", t)], f"d{k}"), constant(f"R{k}", R)], f"l{k}")
        half = constant(f"half{k}", (extents / 2 + 0.002) / unit)
        share = node("Div", [node("Abs", [local], f"a{k}"), half], f"s{k}")
        largest = node("ReduceMax", [share, constant(f"axis{k}", [2], np.int64)], f"m{k}", keepdims=1)
        ratios.append(node("Neg", [largest], f"n{k}"))
        keypoints = KEYPOINTS_UNIT * np.linalg.norm(extents)
        at = apply(T, keypoints) - center
        columns = node("Unsqueeze", ["points", constant(f"u{k}", [2], np.int64)], f"p{k}")
        difference = node("Sub", [columns, constant(f"k{k}", at[None, None] / unit)], f"q{k}")
        radii.append(node("ReduceL2", [difference, constant(f"c{k}", [3], np.int64)], f"r{k}", keepdims=0))
        # On the camera's side of the part: nearer to the camera than the part's middle.
        nearer = np.where(np.linalg.norm(apply(T, keypoints), axis=1) < np.linalg.norm(T[:3, 3]), 6.0, -6.0)
        zeros = node("Mul", [largest, constant(f"z{k}", 0.0)], f"y{k}")
        sides.append(node("Add", [zeros, constant(f"side{k}", nearer[None, None, :voted])], f"w{k}"))
    prefix = [constant(name, value, np.int64) for name, value in (("from", [0]), ("to", [ANSWERED]), ("on", [1]))]
    background = node("Sub", [node("Mul", [ratios[0], constant("zero", 0.0)], "nothing"), constant("one", 1.0)], "b")
    node("Slice", [node("Concat", [*ratios, background], "all_logits", axis=2), *prefix], "part_logits")
    in_base = node("Greater", [ratios[0], ratios[1]], "in_base")
    node("Slice", [node("Where", [in_base, *radii], "all_radii"), *prefix], "radii")
    node("Slice", [node("Where", [in_base, *sides], "all_sides"), *prefix], "side_logits")
    node("Identity", [constant("extents", np.log(EXTENTS_M)[None])], "log_extents")
    return save_bundle(path, nodes, constants, category, (count, voted))


def save_bundle(
    path: Path, nodes: list, constants: list, category: Category, keypoints: tuple[int, int], metadata: bool = True
) -> Path:
    """An .onnx file of the runtime's signature around `nodes`."""
    parts, (count, voted) = len(category.parts), keypoints
    shapes = {"image": [1, 3, IMAGE_SIZE, IMAGE_SIZE], "points": [1, LEVELS[0], 3], "pixels": [1, LEVELS[0], 2]}
    for i in (1, 2, 3):
        shapes[f"group{i}"] = [1, LEVELS[i], GROUP_SIZE]
        shapes[f"up{i}"] = [1, (ANSWERED, *LEVELS[1:])[i - 1], INTERPOLATION_SIZE]
    out_shapes = ([1, ANSWERED, parts + 1], [1, ANSWERED, count], [1, ANSWERED, voted], [1, parts, 3])
    graph = helper.make_graph(
        nodes,
        "oracle",
        [
            helper.make_tensor_value_info(
                name, TensorProto.INT32 if name[:2] in ("gr", "up") else TensorProto.FLOAT, shapes[name]
            )
            for name in INPUT_NAMES
        ],
        [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)
            for name, shape in zip(OUTPUT_NAMES, out_shapes, strict=True)
        ],
        constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=10)
    document = BundleMetadata(category, LEVELS[0], IMAGE_SIZE, 0.005, 18, False, {"recipe": "oracle of a test"})
    onnx.checker.check_model(model)
    path.write_bytes(bundle_bytes(model, document if metadata else None))
    return path
