"""MCAP files, whole or damaged: every message that can be read, and a count of what cannot.

A file is read from its beginning, record by record, so that one that was never closed needs no index. Checksums tell a
damaged chunk, which costs its own messages and no others; from where the records' lengths make no sense nothing more is
read.
Format: https://mcap.dev/spec
"""

from __future__ import annotations

import io
from collections import Counter, OrderedDict
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from page_runtime.image_files import SourceError

MAGIC = b"\x89MCAP0\r\n"
HEAD_BYTES = 16
CHUNKS_KEPT = 3
MAX_RECORD_BYTES = 1 << 32

BYTES_LOST = "bytes of the file that cannot be read"
MESSAGES_LOST = "messages in damaged chunks"
NOT_CLOSED = "end of a file that was never closed"


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic. kind: name of its message type. encoding: of its messages ("cdr", "protobuf")."""

    topic: str
    kind: str
    encoding: str


@dataclass(frozen=True, slots=True)
class MessageRef:
    """Where a message is: the record at `offset`, the `number`th message in it. head: its first bytes."""

    topic: str
    log_time_ns: int
    offset: int
    number: int
    head: bytes


@dataclass(eq=False, slots=True)
class _Contents:
    library: str = ""
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Any] = field(default_factory=dict)
    schema_of: dict[str, Any] = field(default_factory=dict)
    found: list[tuple[int, int, int, int, bytes]] = field(default_factory=list)
    attachments: dict[str, bytes] = field(default_factory=dict)
    missed: Counter[str] = field(default_factory=Counter)
    expected_messages: int | None = None
    closed: bool = False


class McapFile:
    """The messages of the file `path`; `missed` counts what is lost. SourceError when it is no MCAP at all."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            self._file = path.open("rb")
        except OSError as error:
            raise SourceError(f"{path}: cannot read it ({error.strerror})") from error
        self._size = path.stat().st_size
        self._chunks: OrderedDict[int, list[Any]] = OrderedDict()
        if self._file.read(len(MAGIC)) != MAGIC:
            self._file.close()
            raise SourceError(f"{path}: expected an MCAP file, got something else, or one whose beginning is damaged")
        self._contents = self._scan()
        # Channels last: where the first chunk is damaged, the file's end still says what they were.
        known = self._contents.channels
        self._messages = [
            MessageRef(known[channel].topic, log_time_ns, offset, number, head)
            for channel, log_time_ns, offset, number, head in self._contents.found
            if channel in known
        ]
        nameless = len(self._contents.found) - len(self._messages)
        if nameless:
            self._contents.missed[MESSAGES_LOST] += nameless

    @property
    def library(self) -> str:
        """What wrote the file, as it says."""
        return self._contents.library

    @property
    def channels(self) -> tuple[Channel, ...]:
        """The topics."""
        return tuple(self._contents.channels.values())

    @property
    def messages(self) -> list[MessageRef]:
        """Every message that can be read, in the order they were written."""
        return self._messages

    @property
    def attachments(self) -> dict[str, bytes]:
        """Attached files by name."""
        return self._contents.attachments

    @property
    def missed(self) -> dict[str, int]:
        """What cannot be read; empty for a whole file."""
        return dict(self._contents.missed)

    def read(self, ref: MessageRef) -> bytes:
        """The body of one message."""
        return self._messages_at(ref.offset)[ref.number].data

    def schema_of(self, topic: str) -> Any:
        """The mcap Schema record of a topic's messages."""
        return self._contents.schema_of[topic]

    def close(self) -> None:
        """Give the file back."""
        self._file.close()

    def _messages_at(self, offset: int) -> list[Any]:
        if offset not in self._chunks:
            self._file.seek(offset)
            opcode, body = next(self._records())[1:]
            self._chunks[offset] = [r for r in _unpacked(opcode, body) if type(r).__name__ == "Message"]
            while len(self._chunks) > CHUNKS_KEPT:
                self._chunks.popitem(last=False)
        self._chunks.move_to_end(offset)
        return self._chunks[offset]

    def _records(self) -> Iterator[tuple[int, int, bytes]]:
        """(offset, opcode, body) from where the file stands until its end, or until a length makes no sense."""
        while True:
            offset = self._file.tell()
            prefix = self._file.read(9)
            if prefix == MAGIC:
                return
            if len(prefix) < 9:
                self._file.seek(offset)
                return
            length = int.from_bytes(prefix[1:], "little")
            if prefix[0] == 0 or length > min(MAX_RECORD_BYTES, self._size - offset - 9):
                self._file.seek(offset)
                return
            yield offset, prefix[0], self._file.read(length)

    def _scan(self) -> _Contents:
        contents = _Contents()
        for offset, opcode, body in self._records():
            try:
                found = _unpacked(opcode, body)
            except SourceError:
                raise
            except Exception:
                # mcap, lz4 and zstandard raise six unrelated types on damaged bytes, RuntimeError among them.
                contents.missed[BYTES_LOST] += len(body)
                continue
            number = 0
            for record in found:
                number += _take(contents, record, offset, number)
        rest = self._size - self._file.tell()
        if rest and not contents.closed:
            contents.missed[BYTES_LOST] += rest
        if not contents.closed:
            contents.missed[NOT_CLOSED] += 1
        if contents.expected_messages is not None:
            lost = contents.expected_messages - len(contents.found)
            contents.missed.update({MESSAGES_LOST: lost} if lost > 0 else {})
        return contents


def _take(contents: _Contents, record: Any, offset: int, number: int) -> int:
    """Note one record; returns 1 for a message."""
    kind = type(record).__name__
    if kind == "Message":
        head = bytes(record.data[:HEAD_BYTES])
        contents.found.append((record.channel_id, record.log_time, offset, number, head))
        return 1
    if kind == "Header":
        contents.library = record.library
    elif kind == "Schema":
        contents.schemas[record.id] = record
    elif kind == "Channel":
        schema = contents.schemas.get(record.schema_id)
        name = "" if schema is None else schema.name
        contents.channels.setdefault(record.id, Channel(record.topic, name, record.message_encoding))
        contents.schema_of.setdefault(record.topic, schema)
    elif kind == "Attachment":
        contents.attachments[record.name] = record.data
    elif kind == "Statistics":
        contents.expected_messages = record.message_count
    elif kind == "Footer":
        contents.closed = True
    return 0


def _unpacked(opcode: int, body: bytes) -> list[Any]:
    """The record, or the records of a chunk; raises whatever the libraries raise when it is damaged."""
    try:
        from mcap import records
        from mcap.data_stream import ReadDataStream
        from mcap.opcode import Opcode
        from mcap.stream_reader import breakup_chunk
    except ImportError as error:
        raise SourceError("MCAP files need mcap, which is not installed; pip install 'page-edge[ros]'") from error
    stream = ReadDataStream(io.BytesIO(body))
    if opcode == Opcode.CHUNK:
        return breakup_chunk(records.Chunk.read(stream), validate_crc=True)
    if opcode == Opcode.MESSAGE:
        return [records.Message.read(stream, len(body))]
    readers = {
        Opcode.HEADER: records.Header,
        Opcode.SCHEMA: records.Schema,
        Opcode.CHANNEL: records.Channel,
        Opcode.ATTACHMENT: records.Attachment,
        Opcode.STATISTICS: records.Statistics,
        Opcode.FOOTER: records.Footer,
    }
    reader = readers.get(Opcode(opcode)) if opcode in Opcode._value2member_map_ else None
    return [] if reader is None else [reader.read(stream)]
