"""Results kept as they come, one file for each task, so that a validation goes on where it was interrupted."""

from __future__ import annotations

import json
import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from page_runtime.content_hash import own_code_sha256
from page_runtime.validation.comparison import Comparison, comparison_document, comparison_from
from page_runtime.validation.work import Task

VERSION = 1


@dataclass(frozen=True, slots=True)
class ResultsFolder:
    """A folder for each recording, in it a file for each task. A file of another bundle, recording, setting or version
    of this package is not used, and overwritten when the task is done again."""

    path: Path

    def kept(self, task: Task) -> tuple[Comparison, ...] | None:
        """The task's result, None where there is none that holds."""
        with suppress(OSError, ValueError, KeyError, TypeError):
            document = json.loads(self._file(task).read_text(encoding="utf-8"))
            if document["identity"] == _identity(task):
                return tuple(comparison_from(one) for one in document["comparisons"])
        return None

    def keep(self, task: Task, found: tuple[Comparison, ...]) -> None:
        """Write the result, whole or not at all."""
        file = self._file(task)
        file.parent.mkdir(parents=True, exist_ok=True)
        document = {"identity": _identity(task), "comparisons": [comparison_document(one) for one in found]}
        growing = file.with_name(f".{file.name}.{os.getpid()}")
        growing.write_text(json.dumps(document, allow_nan=False) + "\n", encoding="utf-8")
        growing.replace(file)

    def _file(self, task: Task) -> Path:
        folder = f"{Path(task.recording).name}-{task.recording_sha256[:12]}-{task.bundle_sha256[:12]}"
        return self.path / folder / f"{task.first:06d}-{task.last:06d}.json"


def _identity(task: Task) -> dict[str, Any]:
    """As JSON gives it back, so that the two can be compared."""
    return json.loads(json.dumps({"version": VERSION, "code_sha256": own_code_sha256(), **task.identity()}))
