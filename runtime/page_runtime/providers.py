"""What a network may run on: onnxruntime's execution providers by short names, what is told of the choice, and what is
raised where it does not run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

AUTO, CPU = "auto", "cpu"
CPU_PROVIDER = "CPUExecutionProvider"
# Short name: onnxruntime's name, the package that has it, options that are not its defaults.
_KNOWN: dict[str, tuple[str, str, dict[str, str]]] = {
    "cpu": (CPU_PROVIDER, "onnxruntime", {}),
    "tensorrt": (
        "TensorrtExecutionProvider",
        "onnxruntime-gpu and TensorRT",
        {"trt_engine_cache_enable": "1", "trt_engine_cache_path": ".page-tensorrt"},
    ),
    "cuda": ("CUDAExecutionProvider", "onnxruntime-gpu", {"cudnn_conv_algo_search": "HEURISTIC"}),
    "openvino": ("OpenVINOExecutionProvider", "onnxruntime-openvino", {"device_type": "CPU"}),
    "coreml": ("CoreMLExecutionProvider", "onnxruntime on macOS", {"ModelFormat": "MLProgram"}),
    "qnn": ("QNNExecutionProvider", "onnxruntime-qnn", {"backend_type": "htp"}),
    "xnnpack": ("XnnpackExecutionProvider", "onnxruntime built with XNNPACK", {}),
}
PROVIDERS = (AUTO, *_KNOWN)
# What auto takes, the first that this onnxruntime has. Not XNNPACK, whose operators are few, and not OpenVINO: on a CPU
# it took 10.1 ms where onnxruntime's own kernels took 11.2 on one thread, 10.9 against 9.5 on two, and 0.4 s to load.
_PREFERRED = ("tensorrt", "cuda", "coreml", "qnn", "cpu")


class ProviderError(RuntimeError):
    """A provider that was asked for cannot run the network here; the message says why and what would."""


class NetworkError(RuntimeError):
    """onnxruntime failed while it ran a network that it had loaded; `__cause__` is what it raised."""


@dataclass(frozen=True, slots=True)
class ProviderChoice:
    """provider: a short name of PROVIDERS. options: of onnxruntime, over the defaults here. required: it must all run
    there; what it cannot run is an error then, and runs on the CPU otherwise."""

    provider: str = CPU
    options: tuple[tuple[str, str], ...] = ()
    required: bool = False


ON_CPU = ProviderChoice()


def resolved(choice: ProviderChoice, available: Sequence[str]) -> tuple[str, dict[str, str]]:
    """onnxruntime's name and options for a choice, of the providers this onnxruntime has.

    ProviderError for a name that is not known, and for one that is not here: another takes its place only where `auto`
    was asked for. Also for options where the CPU is chosen: nothing would read them.
    """
    if choice.provider not in PROVIDERS:
        raise ProviderError(f"provider: expected one of {', '.join(PROVIDERS)}, got {choice.provider!r}")
    name = choice.provider
    if name == AUTO:
        name = next(one for one in _PREFERRED if _KNOWN[one][0] in available)
    full, package, options = _KNOWN[name]
    if full not in available:
        here = ", ".join(short for short, (known, *_) in _KNOWN.items() if known in available)
        raise ProviderError(f"provider {name}: this onnxruntime does not have it (it has {here}); install {package}")
    if choice.options and full == CPU_PROVIDER:
        given = ", ".join(key for key, _ in choice.options)
        what = "the CPU is the best there is here, which" if choice.provider == AUTO else "it"
        raise ProviderError(
            f"provider {choice.provider}: {what} has no options, got {given}; leave them out, or name the provider "
            "they are for"
        )
    return full, {**options, **dict(choice.options)}


def short_name(full: str) -> str:
    """The short name of one of onnxruntime's providers."""
    return next((short for short, (known, *_) in _KNOWN.items() if known == full), full)


def described(operators: Mapping[str, int]) -> str:
    """In words, where how many operators run (or subgraphs that a provider took as one)."""
    return ", ".join(f"{short_name(name)} {count}" for name, count in operators.items())
