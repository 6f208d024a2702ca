"""The topics of a bag and their messages, whatever stores them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from page_runtime.capture import ros_messages as ros
from page_runtime.capture.mcap_file import Channel, MessageRef
from page_runtime.image_files import SourceError

# What the names of depth topics say that are registered to colour.
REGISTERED_WORDS = ("aligned_depth", "depth_registered", "depth_to_color", "registered")


class MessageStore(Protocol):
    """A file of messages."""

    @property
    def channels(self) -> tuple[Channel, ...]: ...
    @property
    def messages(self) -> list[MessageRef]: ...
    @property
    def missed(self) -> dict[str, int]: ...
    @property
    def attachments(self) -> dict[str, bytes]: ...
    def read(self, ref: MessageRef) -> bytes: ...


Stored = tuple[MessageStore, MessageRef]


@dataclass(frozen=True, eq=False, slots=True)
class Topics:
    """A bag's messages. kinds: the type of each topic. messages: those of each topic, in order."""

    path: Path
    kinds: Mapping[str, str]
    messages: Mapping[str, Sequence[Stored]]

    def decoded(self, stored: Stored) -> Any:
        """A message as an object; SourceError when it is damaged."""
        store, ref = stored
        return ros.decode(store.read(ref), self.kinds[ref.topic], where=f"{self.path}: {ref.topic}")

    def of_kind(self, kind: str) -> list[str]:
        """The topics of a type that have messages."""
        return [topic for topic, own in self.kinds.items() if own == kind and self.messages.get(topic)]

    def first(self, topic: str) -> Any:
        """The first message of a topic that can be decoded, None where there is none."""
        return first_of(self.messages.get(topic, ()), self.kinds[topic])


def first_of(messages: Sequence[Stored], kind: str) -> Any:
    """The first message that can be decoded, of ten; None where there is none."""
    for store, ref in messages[:10]:
        try:
            return ros.decode(store.read(ref), kind, where=ref.topic)
        except SourceError:
            continue
    return None
