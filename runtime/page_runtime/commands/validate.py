"""page-runtime validate: estimates against the truth of recordings."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from page_runtime.commands.inputs import load_network, require_fitting, require_region
from page_runtime.commands.outputs import require_file_place, require_folder_place, text_output, write_json
from page_runtime.commands.sources import open_recorded
from page_runtime.commands.terminal import Progress
from page_runtime.commands.usage import UsageError
from page_runtime.commands.validation_tables import readable
from page_runtime.content_hash import sha256_of
from page_runtime.network import Network
from page_runtime.providers import ProviderChoice
from page_runtime.recorded import Source
from page_runtime.report.validation_page import validation_page
from page_runtime.report.worst import worst_objects
from page_runtime.validation.cluster import by_cluster
from page_runtime.validation.comparison import Comparison
from page_runtime.validation.processes import Done, WorkerLost, by_processes, one_after_the_other
from page_runtime.validation.results import ResultsFolder
from page_runtime.validation.study import Study, document_of
from page_runtime.validation.symmetry_choice import SymmetryChoice, symmetry_choice, with_symmetries
from page_runtime.validation.work import Task

# Of each process, where --threads does not say otherwise. onnxruntime adds up in another order with another number, and
# the same recording shall have the same figures whatever the machine has and however many processes share the work.
THREADS = 1


def validate(
    recordings: Sequence[str],
    *,
    bundle: Sequence[Path],
    json: Path | None,
    overlay: Path | None,
    report: Path | None,
    results: Path | None,
    processes: int,
    cluster: str | None,
    symmetry: Sequence[str],
    paper: bool,
    seed: int,
    window_s: float,
    threads: int,
    on: ProviderChoice,
    looks: int,
    quiet: bool,
) -> None:
    """Estimate every object with truth in all `recordings`; write the figures to `json`, a page to `report` and tables
    to standard output."""
    if processes < 1:
        raise UsageError(f"--processes: expected at least 1, got {processes}")
    if cluster is not None and (processes > 1 or overlay is not None):
        raise UsageError("--cluster: it has its own processes and draws no pictures; leave --processes, --overlay out")
    choices = _choices(symmetry)
    threads = threads or THREADS
    studies = _studies(recordings, bundle, threads=threads, looks=looks, on=on, window_s=window_s, choices=choices)
    for path, option in ((json, "--json"), (report, "--report")):
        require_file_place(path, option=option)
    for path, option in ((overlay, "--overlay"), (results, "--results")):
        require_folder_place(path, option=option)
    folder = None if results is None else ResultsFolder(results)
    settings = {"looks": looks, "window_s": window_s, "threads": threads, "symmetry": choices, "on": on}
    with _pictures(overlay, studies) as places:
        tasks = {study.name: study.tasks(pictures=places[study.name], **settings) for study in studies}
        every = [task for own in tasks.values() for task in own]
        found = _done(every, folder, again=overlay is not None, processes=processes, cluster=cluster, quiet=quiet)
    comparisons = {name: [one for task in own for one in found[task]] for name, own in tasks.items()}
    document = document_of(studies, comparisons, looks=looks, symmetry=choices, seed=seed)
    if json is not None:
        write_json(json, document)
    if report is not None:
        worst = worst_objects(studies, comparisons, looks=looks, threads=threads, on=on)
        with text_output(report) as file:
            file.write(validation_page(document, comparisons, worst))
    sys.stdout.write(readable(document, paper=paper))


def _choices(given: Sequence[str]) -> tuple[SymmetryChoice, ...]:
    try:
        return tuple(symmetry_choice(text) for text in given)
    except ValueError as error:
        raise UsageError(f"--symmetry: {error}") from error


def _studies(
    recordings: Sequence[str],
    bundles: Sequence[Path],
    *,
    threads: int,
    looks: int,
    on: ProviderChoice,
    window_s: float,
    choices: tuple[SymmetryChoice, ...],
) -> list[Study]:
    """Every recording with the bundle of its category; UsageError where one has none, or two."""
    known = [(path, load_network(path, threads=threads, looks=looks, on=on)[0], sha256_of(path)) for path in bundles]
    for path, network, _ in known:
        try:
            with_symmetries(network.metadata.category, choices)
        except ValueError as error:
            raise UsageError(f"--symmetry: {path}: {error}") from error
    studies: list[Study] = []
    names = _names(recordings)
    for name, recording in zip(names, recordings, strict=True):
        source = open_recorded(recording, window_s=window_s, command="validate")
        path, network, bundle_sha256 = _bundle_of(recording, source, known)
        require_fitting(path, network, recording, source)
        require_region(recording, source, None, otherwise="validate needs regions and true poses")
        if not source.has_truth:
            raise UsageError(f"{recording}: this {source.format} has no true poses to compare with")
        sha256, category = sha256_of(source.path), network.metadata.category
        studies.append(Study(name, Path(recording), sha256, source, path, bundle_sha256, category))
    return studies


def _bundle_of(recording: str, source: Source, known: Sequence[tuple[Path, Network, str]]) -> tuple[Path, Network, str]:
    if len(known) == 1:
        return known[0]
    own = [one for one in known if one[1].metadata.category.name == source.category]
    if len(own) != 1:
        categories = ", ".join(network.metadata.category.name for _, network, _ in known)
        raise UsageError(
            f"{recording}: holds {source.category!r}, the bundles are for {categories}; expected one --bundle for each"
        )
    return own[0]


def _names(recordings: Sequence[str]) -> list[str]:
    """The last part of each path, and as much more of it as tells recordings of the same name apart."""
    if len(set(recordings)) < len(recordings):
        raise UsageError("validate: the same recording was given twice")
    paths = [Path(recording).resolve() for recording in recordings]
    for depth in range(1, max(len(path.parts) for path in paths) + 1):
        names = ["/".join(path.parts[-depth:]) for path in paths]
        if len(set(names)) == len(names):
            return names
    raise UsageError("validate: the same recording was given twice")


def _done(
    tasks: Sequence[Task],
    folder: ResultsFolder | None,
    *,
    again: bool,
    processes: int,
    cluster: str | None,
    quiet: bool,
) -> dict[Task, tuple[Comparison, ...]]:
    """The result of every task: kept from before unless `again`, or computed now and kept."""
    found: dict[Task, tuple[Comparison, ...]] = {}
    if folder is not None and not again:
        found = {task: kept for task in tasks if (kept := folder.kept(task)) is not None}
    waiting = [task for task in tasks if task not in found]
    total = sum(task.frames for task in waiting)
    if found and not quiet:
        sys.stderr.write(f"validate: {sum(task.frames for task in found)} frames were done before\n")
    with Progress("validate", total, quiet=quiet) as progress:
        for task, comparisons in _computed(waiting, processes, cluster, progress):
            if folder is not None:
                folder.keep(task, comparisons)
            found[task] = comparisons
    return found


def _computed(tasks: Sequence[Task], processes: int, cluster: str | None, progress: Progress) -> Iterator[Done]:
    if cluster is None and processes == 1:
        yield from one_after_the_other(tasks, progress.advance)
        return
    try:
        for task, comparisons in by_processes(tasks, processes) if cluster is None else by_cluster(tasks, cluster):
            for _ in range(task.frames):
                progress.advance()
            yield task, comparisons
    except WorkerLost as error:
        raise UsageError(str(error)) from error


@contextmanager
def _pictures(overlay: Path | None, studies: Sequence[Study]) -> Iterator[dict[str, Path | None]]:
    """A folder for each study's pictures, all None without `overlay`; they take their place when the block ends well.
    The pictures of one recording lie in `overlay` itself, of several in a folder each."""
    if overlay is None:
        yield dict.fromkeys((study.name for study in studies), None)
        return
    # Inside the folder where there is one, which may be a file system of its own: files cannot be moved into that.
    inside = overlay if overlay.is_dir() else overlay.resolve().parent
    staging = Path(tempfile.mkdtemp(prefix=f".{overlay.name}.", suffix=".partial", dir=inside))
    alone = len(studies) == 1
    try:
        yield {study.name: staging if alone else staging / study.name for study in studies}
        for file in sorted(path for path in staging.rglob("*") if path.is_file()):
            target = overlay / file.relative_to(staging)
            target.parent.mkdir(parents=True, exist_ok=True)
            file.replace(target)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
