"""Recordings of ROS: bags of ROS 1 and 2, and MCAP, read message by message through ``rosbags``, without ROS."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from depthcli.core.errors import ConfigError, DepthcliError, InputError
from depthcli.core.text import one_line
from depthcli.io.formats.files import naming, open_regular, refuse_stored

RECORDING_SUFFIXES = (".bag", ".mcap", ".db3")
"""File name endings of recordings; a recording of ROS 2 may also be a folder with ``metadata.yaml``."""

_METADATA = "metadata.yaml"
_MAX_REASON = 160  # characters of a library's message
_NANOSECONDS = 1e9

_REPAIR = {
    ".bag": "; a bag that was not closed is repaired by rosbag reindex",
    ".mcap": "; a file that was not closed is repaired by mcap recover",
}


@dataclass(frozen=True)
class Topic:
    """One topic of a recording.

    Attributes
    ----------
    name : as recorded
    kind : type of its messages without its package: ``Image``
    count : number of messages, as the recording says
    rate : messages a second of the whole recording, or 0
    """

    name: str
    kind: str
    count: int
    rate: float


_Read = TypeVar("_Read")


class Message(NamedTuple):
    """One recorded message, not decoded yet: topic, type with its package, time of the recording (ns), bytes."""

    topic: str
    kind: str
    time: int
    data: bytes


class Recording:
    """An open recording; see :func:`open_recording`."""

    def __init__(self, path: Path, reader: Any, is_ros1: bool) -> None:
        self.path, self._reader, self._is_ros1 = path, reader, is_ros1
        self._decoders: dict[str, Callable[[bytes], Any]] = {}

    @property
    def topics(self) -> dict[str, Topic]:
        """The topics by name, sorted; InputError where their list is damaged."""
        found: dict[str, Topic] = {}
        with _library_errors("damaged"):
            seconds = max(float(self._reader.duration) / _NANOSECONDS, 0.0)
            for connection in sorted(self._reader.connections, key=lambda each: str(each.topic)):
                name, count = str(connection.topic), int(connection.msgcount)
                count += found[name].count if name in found else 0
                rate = (count - 1) / seconds if seconds and count > 1 else 0.0
                found[name] = Topic(name, _short(str(connection.msgtype)), count, rate)
        return found

    def messages(self, topics: Collection[str]) -> Iterator[Message]:
        """Yield the messages of ``topics`` in the order of their recording.

        Raises
        ------
        InputError
            The recording is damaged; what was yielded before is not.
        """
        connections = [each for each in self._reader.connections if each.topic in topics]
        if not connections:
            return
        with _library_errors("damaged"):
            for connection, time, data in self._reader.messages(connections):
                yield Message(connection.topic, connection.msgtype, time, data)

    def decode(self, message: Message) -> Any:
        """Return a message as an object with the fields of its type; InputError where its bytes are no such message."""
        with _library_errors("a damaged message"):
            if message.kind not in self._decoders:
                self._decoders[message.kind] = self._decoder(message.kind)
            return self._decoders[message.kind](message.data)

    def read(self, message: Message, reader: Callable[[Any], _Read]) -> _Read:
        """Return what ``reader`` makes of a message.

        Raises
        ------
        InputError
            Its bytes are no such message, lack fields that the type should have, or the reader raises it.
        """
        decoded = self.decode(message)
        try:
            return reader(decoded)
        except (AttributeError, TypeError, ValueError, OverflowError) as error:  # by another type of that name
            raise InputError(
                f"{message.topic}: no {_short(message.kind)} ({one_line(str(error))[:_MAX_REASON]})"
            ) from error

    def _decoder(self, kind: str) -> Callable[[bytes], Any]:
        # Types are taken from the recording one by one: definitions of others, which may be odd, do not matter, and
        # neither do check sums, which programs that change a definition do not renew (librealsense).
        from rosbags.interfaces import MessageDefinitionFormat
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

        known = [each.msgdef for each in self._reader.connections if each.msgtype == kind]
        definition = next((each for each in known if each.format != MessageDefinitionFormat.NONE), None)
        if definition is None:  # bags of ROS 2 before Iron have none
            store = get_typestore(Stores.ROS1_NOETIC if self._is_ros1 else Stores.ROS2_HUMBLE)
            if kind not in store.types:
                raise InputError(f"the recording does not hold the definition of {kind}")
        else:
            store = get_typestore(Stores.EMPTY)
            if definition.format == MessageDefinitionFormat.MSG:
                store.register(get_types_from_msg(definition.data, kind))
            else:
                separator = "=" * 80 + "\n"
                for part in definition.data.split(separator):
                    if part.strip():
                        store.register(get_types_from_idl(part.partition("\n")[2] if part[:4] == "IDL:" else part))
        if not self._is_ros1:
            return lambda data: store.deserialize_cdr(data, kind)
        described = store.get_msgdef(kind)
        # Bytes behind the message are passed over: librealsense appends fields that its definitions do not have.
        return lambda data: described.deserialize_ros1(data, 0, described.cls, store)[0]


def check_library() -> None:
    """Raise ConfigError where ``rosbags`` is not installed."""
    try:
        import rosbags.rosbag1
        import rosbags.rosbag2  # noqa: F401
    except ImportError:
        raise ConfigError("recordings need rosbags: pip install 'depthcli[ros]'") from None


@contextmanager
def open_recording(path: Path) -> Iterator[Recording]:
    """Open a recording: a bag of ROS 1, an MCAP file, a database of ROS 2, or the folder of a bag of ROS 2.

    Raises
    ------
    ConfigError
        ``rosbags`` is not installed.
    InputError
        It cannot be read, is no recording, or was not closed; one line that names it.
    """
    check_library()
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2 import Reader as Ros2Reader

    for file in recording_files(path):
        refuse_stored(file)
        with open_regular(file):  # the library would wait for the other end of a pipe
            pass
    is_ros1 = not os.path.isdir(path) and path.suffix.lower() == ".bag"
    with naming(path):
        with _library_errors("cannot be read as a recording", _REPAIR.get(path.suffix.lower(), "")):
            reader: Any = Ros1Reader(path) if is_ros1 else Ros2Reader(path)
            reader.open()
        try:
            yield Recording(path, reader, is_ros1)
        finally:
            reader.close()


def recording_files(path: Path) -> list[Path]:
    """Return the files of a recording: the file itself, or those of a folder of ROS 2; InputError for another path."""
    if not os.path.isdir(path):
        if os.path.lexists(path) and path.suffix.lower() not in RECORDING_SUFFIXES:
            raise InputError(f"{path}: no recording; want {', '.join(RECORDING_SUFFIXES)}, or a folder of ROS 2")
        return [path]
    if not os.path.lexists(path / _METADATA):
        raise InputError(f"{path}: no recording in it, and no {_METADATA} of a bag of ROS 2")
    inside = sorted(each for each in path.iterdir() if not each.name.startswith(".") and not os.path.isdir(each))
    return [each for each in inside if each.name == _METADATA or _is_data(each.name)]


def find_recordings(path: Path) -> list[Path]:
    """Return the recordings that a path stands for: itself, or those in a folder, sorted; InputError for none."""
    if not os.path.lexists(path):
        raise InputError(f"{path}: no such file or folder")
    if not os.path.isdir(path) or os.path.lexists(path / _METADATA):
        recording_files(path)
        return [path]
    try:
        inside = sorted(each for each in path.iterdir() if not each.name.startswith("."))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error
    found = [
        each
        for each in inside
        if (os.path.lexists(each / _METADATA) if os.path.isdir(each) else each.suffix.lower() in RECORDING_SUFFIXES)
    ]
    if not found:
        raise InputError(f"{path}: no recordings in it ({', '.join(RECORDING_SUFFIXES)}, or folders of ROS 2)")
    return found


def _is_data(name: str) -> bool:
    return name.endswith((".db3", ".mcap", ".zstd"))


def _short(kind: str) -> str:
    return kind.rpartition("/")[2]


@contextmanager
def _library_errors(what: str, hint: str = "") -> Iterator[None]:
    """Make an InputError of whatever the library raises: by damaged files it is any exception."""
    try:
        yield
    except DepthcliError:
        raise
    except Exception as error:
        reason = one_line(str(error))[:_MAX_REASON] or type(error).__name__
        if isinstance(error, KeyError):  # such as MCAP with the schemas of other programs: ros1msg, protobuf
            reason = f"{reason} is not known to rosbags"
        raise InputError(f"{what} ({reason}){hint}") from error
