"""What a measurement was made on: processor, governor, versions, commit, memory, energy."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("page-edge", "numpy", "onnxruntime", "opencv-python-headless")
CPUS = Path("/sys/devices/system/cpu")
POWERCAP = Path("/sys/class/powercap")


def peak_rss_mb() -> float | None:
    """The largest resident memory of this process so far, in 10^6 bytes; None where the system does not tell."""
    try:
        import resource
    except ImportError:
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return round(peak * (1 if sys.platform == "darwin" else 1024) / 1e6, 1)


def versions(packages: Iterable[str] = PACKAGES) -> dict[str, str]:
    """Of Python and of packages; by default those the runtime computes with."""
    found = {"python": platform.python_version()}
    for package in packages:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed as a package"
    return found


def available_processors() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def most_threads() -> int:
    """How many a session may have: four for each processor, and 16 in any case. More of them only wait for each other:
    100,000 took 5.7 GB and minutes."""
    return max(16, 4 * available_processors())


def check_threads(threads: int) -> None:
    """ValueError for a number of threads that no session here may have; 0 leaves it to whoever makes the session."""
    if not 0 <= threads <= most_threads():
        raise ValueError(
            f"threads: expected 1 to {most_threads()} on this machine, or 0 for as many as suit it, got {threads}"
        )


def cpu_name() -> str:
    """The processor's name as the system gives it."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.is_file():
        for line in cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith(("model name", "Model")):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def governors(cpus: Path = CPUS) -> list[str]:
    """The frequency governors in use, without repeats; [] where the system shows none, as most virtual machines."""
    found = set()
    for file in cpus.glob("cpu[0-9]*/cpufreq/scaling_governor"):
        try:
            found.add(file.read_text(encoding="utf-8").strip())
        except OSError:
            continue
    return sorted(found)


def load_average() -> float | None:
    """Of the last minute; None where the system does not tell."""
    return round(os.getloadavg()[0], 2) if hasattr(os, "getloadavg") else None


def commit() -> str | None:
    """Of the sources this package runs from, with "+changes" where they were edited since; None where they are no
    work tree of git."""
    folder = Path(__file__).resolve().parent
    revision = _git(folder, "rev-parse", "HEAD")
    if revision is None:
        return None
    return revision + ("+changes" if _git(folder, "status", "--porcelain", "--", ".") else "")


def _git(folder: Path, *arguments: str) -> str | None:
    try:
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, text=True, check=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


@dataclass(frozen=True, slots=True)
class EnergyCounter:
    """A RAPL package domain. range_uj: where it starts again from 0."""

    file: Path
    range_uj: int

    def read_uj(self) -> int:
        return int(self.file.read_text(encoding="utf-8"))

    def used_j(self, before_uj: int, after_uj: int) -> float:
        """Joules between two readings less than one round apart."""
        return ((after_uj - before_uj) % (self.range_uj + 1)) * 1e-6


def energy_counters(powercap: Path = POWERCAP) -> list[EnergyCounter]:
    """The packages' RAPL counters that may be read, [] where there are none or only root may."""
    found = []
    for folder in sorted(powercap.glob("intel-rapl:[0-9]*")):
        if folder.name.count(":") != 1:
            continue  # A domain inside a package, which the package's counter includes.
        try:
            counter = EnergyCounter(folder / "energy_uj", int((folder / "max_energy_range_uj").read_text()))
            counter.read_uj()
        except (OSError, ValueError):
            continue
        found.append(counter)
    return found
