"""One line of JSON for every result (`schema.result_record`): into a file, to standard output, or as UDP datagrams."""

from __future__ import annotations

import os
import socket
import sys
from pathlib import Path

from page_runtime.live.result import LiveResult
from page_runtime.schema import json_line, result_record


class LineSink:
    """Lines into a descriptor, each handed to the system whole before the next one, so that a kill costs none that was
    written. The descriptor is the sink's own from then on."""

    def __init__(self, descriptor: int, *, name: str) -> None:
        self._descriptor, self._name = descriptor, name
        self._rest = b""

    @property
    def name(self) -> str:
        return self._name

    def write(self, result: LiveResult) -> None:
        """Append one line; OSError when the descriptor takes no more."""
        # What a full disk left of the line before goes first, or two lines would be one.
        self._send()
        self._rest = line = json_line(result_record(result)).encode()
        try:
            self._send()
        except OSError:
            if len(self._rest) == len(line):
                self._rest = b""
            raise

    def _send(self) -> None:
        # Not through sys.stdout: its lock, held by a write that blocks, would abort the interpreter at its end.
        while self._rest:
            self._rest = self._rest[os.write(self._descriptor, self._rest) :]

    def close(self) -> None:
        """Give the descriptor back."""
        os.close(self._descriptor)


def line_file(path: Path) -> LineSink:
    """Lines into the new file `path`; FileExistsError when it is there already."""
    return LineSink(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_APPEND, 0o666), name=f"lines {path}")


def line_stdout() -> LineSink:
    """Lines to standard output."""
    sys.stdout.flush()
    return LineSink(os.dup(sys.stdout.fileno()), name="lines stdout")


class UdpSink:
    """A datagram a result to one address; nobody need listen. OSError for a line above 65,507 bytes."""

    def __init__(self, host: str, port: int) -> None:
        """Look the address up; OSError when there is none of that name."""
        family, kind, protocol, _, self._address = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, kind, protocol)
        self._name = f"udp {host}:{port}"

    @property
    def name(self) -> str:
        return self._name

    def write(self, result: LiveResult) -> None:
        """Send one datagram. Not connected: a listener that is away would make every other send an error."""
        self._socket.sendto(json_line(result_record(result)).encode(), self._address)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
