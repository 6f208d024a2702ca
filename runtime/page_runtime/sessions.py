"""onnxruntime's sessions: how they are made, on which provider, and run; the only module that imports onnxruntime."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import onnxruntime as ort
from numpy.typing import NDArray

from page_runtime.bundle_fields import BundleError
from page_runtime.machine import check_threads
from page_runtime.providers import CPU_PROVIDER, ProviderChoice, ProviderError, resolved, short_name

# The largest of the usual detectors has 270 MB.
MAX_DETECTOR_BYTES = 512 << 20


class DeadlineExceeded(TimeoutError):
    """A forward pass was given up because its time was over."""


def session_options(threads: int) -> ort.SessionOptions:
    """How every session here runs: so many threads, which wait by spinning for 50 us and sleep then.

    ValueError for more threads than `machine.most_threads`. A worker that sleeps at once is woken for every operator:
    two threads were no faster than one, 11.6 and 11.0 ms. One that spins for as long as onnxruntime's default does
    takes a core from the scorer, which runs between two passes. numpy's own threads and OpenCV's are set by the command
    (`cli._prepare`, `commands.inputs`).
    """
    check_threads(threads)
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.log_severity_level = 3
    options.add_session_config_entry("session.intra_op.spin_duration_us", "50")
    return options


def session_on(
    on: ProviderChoice, path: Path, data: bytes, options: ort.SessionOptions, *, without: Sequence[str] = ()
) -> tuple[ort.InferenceSession, str, str]:
    """A session of the bundle `data` on the provider chosen, that provider's name with onnxruntime, and why the CPU has
    it instead; empty where it has not.

    ProviderError where the provider cannot be had, or cannot run it and is required; BundleError where the CPU cannot
    either. path: named in errors. without: names of optimisations.
    """
    provider, provider_options = resolved(on, ort.get_available_providers())
    instead = ""
    if provider != CPU_PROVIDER:
        name = short_name(provider)
        if not hasattr(ort.InferenceSession, "get_provider_graph_assignment_info"):
            raise ProviderError(
                f"provider {name}: expected onnxruntime 1.24 or later, which says what runs where, got "
                f"{ort.__version__}; install a later one, or take the provider cpu"
            )
        options.add_session_config_entry("session.record_ep_graph_assignment_info", "1")
        if on.required:
            options.add_session_config_entry("session.disable_cpu_ep_fallback", "1")
        try:
            session = _session(data, options, provider, provider_options, without)
        except Exception as error:  # onnxruntime raises many unrelated classes for one cause
            instead = f"provider {name}: cannot run {path} ({first_line(error)})"
            if on.required:
                raise ProviderError(f"{instead}; where it is not required, the CPU runs it instead") from error
        else:
            # A provider whose libraries cannot be loaded is left out without an error.
            started = provider in session.get_providers()
            return session, provider, "" if started else f"provider {name}: onnxruntime could not start it"
    try:
        return _session(data, options, CPU_PROVIDER, {}, without), provider, instead
    except Exception as error:  # as above, for a file it cannot load
        raise BundleError(
            f"bundle {path}: onnxruntime cannot load it ({first_line(error)}); is it an exported, complete .onnx file?"
        ) from error


def open_session(path: Path, *, threads: int) -> ort.InferenceSession:
    """A session of a user's own .onnx file, a detector, on the CPU; BundleError with the reason where there can be
    none."""
    if not path.is_file():
        raise BundleError(f"{path}: there is no such file; expected an .onnx file")
    size = path.stat().st_size
    if not 0 < size <= MAX_DETECTOR_BYTES:
        raise BundleError(f"{path}: expected 1 to {MAX_DETECTOR_BYTES} bytes, got {size}")
    options = session_options(threads)
    try:
        return _session(path.read_bytes(), options, CPU_PROVIDER, {}, ())
    except Exception as error:  # as in `session_on`
        reason = first_line(error)
        raise BundleError(f"{path}: onnxruntime cannot load it ({reason}); is it a complete .onnx file?") from error


def _session(
    data: bytes,
    options: ort.SessionOptions,
    provider: str,
    provider_options: Mapping[str, str],
    without: Sequence[str],
) -> ort.InferenceSession:
    """A session that raises whatever fails: onnxruntime's own way back to the CPU prints to standard output, where
    results go."""
    if provider == CPU_PROVIDER:
        # What fails there is raised, and need not be logged as well. Of another provider's libraries it is only logged.
        options.log_severity_level = 4
    return ort.InferenceSession(
        data,
        options,
        providers=[(provider, dict(provider_options))],
        disabled_optimizers=list(without),
        enable_fallback=0,
    )


def run_session(
    session: ort.InferenceSession, names: Sequence[str], given: Mapping[str, NDArray[Any]], seconds: float | None = None
) -> Sequence[Any]:
    """The outputs of those names. DeadlineExceeded after so many seconds, above 0; onnxruntime's errors as they are, of
    many unrelated classes."""
    # No timer can wait for longer than TIMEOUT_MAX, which is weeks at least.
    if seconds is None or seconds > threading.TIMEOUT_MAX:
        return session.run(names, given)
    run_options = ort.RunOptions()
    over = threading.Event()

    def end() -> None:
        over.set()
        run_options.terminate = True

    timer = threading.Timer(seconds, end)
    timer.daemon = True
    timer.start()
    try:
        return session.run(names, given, run_options)
    except Exception as error:  # onnxruntime says only "Fail" of a run that was told to end
        if over.is_set():
            raise DeadlineExceeded(
                f"network: not done within {1e3 * seconds:.1f} ms; allow more time, or use a quicker bundle"
            ) from error
        raise
    finally:
        timer.cancel()


def first_line(error: Exception) -> str:
    """Of what onnxruntime says: the lines after it are about its own sources."""
    return next(iter(str(error).splitlines()), type(error).__name__)


def available_providers() -> tuple[str, ...]:
    """What this onnxruntime could run a network with."""
    return tuple(ort.get_available_providers())
