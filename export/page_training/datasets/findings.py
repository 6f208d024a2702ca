"""What a check of a data set has to say."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Severity = Literal["error", "warning", "fine"]


@dataclass(frozen=True, slots=True)
class Finding:
    """what: of one kind of check; where: the first place, if it has one."""

    severity: Severity
    check: str
    what: str
    where: str = ""
