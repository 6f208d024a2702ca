"""page_runtime: the 6D pose of every rigid part of articulated objects from RGB-D, without a GPU.

    network = Network("laptop.onnx")
    for recorded in open_source("recording"):
        for instance in recorded.instances:
            if instance.region is not None:
                pose = estimate(network, recorded.frame, instance.region)

Importing the package loads none of it: each name brings its module when it is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from page_runtime.bundle import BundleMetadata
    from page_runtime.bundle_fields import BundleError
    from page_runtime.camera import Camera
    from page_runtime.capture.playback import open_source
    from page_runtime.category import Category, Joint, Part
    from page_runtime.estimator import estimate
    from page_runtime.frame import RgbdFrame
    from page_runtime.image_files import SourceError
    from page_runtime.live.faults import FrameFault, FramesFailing
    from page_runtime.live.loop import LiveLoop
    from page_runtime.live.result import LiveObject, LiveResult, LoopCounts
    from page_runtime.live.start import live_results
    from page_runtime.network import Network
    from page_runtime.overlay import draw
    from page_runtime.pose import ArticulatedPose, NotSeen, PartPose
    from page_runtime.providers import NetworkError, ProviderChoice, ProviderError
    from page_runtime.recorded import Instance, PartTruth, RecordedFrame, Source
    from page_runtime.recording import RecordingWriter
    from page_runtime.sampling import Region
    from page_runtime.schema import pose_record
    from page_runtime.sessions import DeadlineExceeded

_MODULE_OF_NAME = {
    "ArticulatedPose": "pose",
    "BundleError": "bundle_fields",
    "BundleMetadata": "bundle",
    "Camera": "camera",
    "Category": "category",
    "DeadlineExceeded": "sessions",
    "FrameFault": "live.faults",
    "FramesFailing": "live.faults",
    "Instance": "recorded",
    "Joint": "category",
    "LiveLoop": "live.loop",
    "LiveObject": "live.result",
    "LiveResult": "live.result",
    "LoopCounts": "live.result",
    "Network": "network",
    "NetworkError": "providers",
    "NotSeen": "pose",
    "Part": "category",
    "PartPose": "pose",
    "PartTruth": "recorded",
    "ProviderChoice": "providers",
    "ProviderError": "providers",
    "RecordedFrame": "recorded",
    "RecordingWriter": "recording",
    "Region": "sampling",
    "RgbdFrame": "frame",
    "Source": "recorded",
    "SourceError": "image_files",
    "draw": "overlay",
    "estimate": "estimator",
    "live_results": "live.start",
    "open_source": "capture.playback",
    "pose_record": "schema",
}

__all__ = [
    "ArticulatedPose",
    "BundleError",
    "BundleMetadata",
    "Camera",
    "Category",
    "DeadlineExceeded",
    "FrameFault",
    "FramesFailing",
    "Instance",
    "Joint",
    "LiveLoop",
    "LiveObject",
    "LiveResult",
    "LoopCounts",
    "Network",
    "NetworkError",
    "NotSeen",
    "Part",
    "PartPose",
    "PartTruth",
    "ProviderChoice",
    "ProviderError",
    "RecordedFrame",
    "RecordingWriter",
    "Region",
    "RgbdFrame",
    "Source",
    "SourceError",
    "draw",
    "estimate",
    "live_results",
    "open_source",
    "pose_record",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF_NAME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF_NAME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
