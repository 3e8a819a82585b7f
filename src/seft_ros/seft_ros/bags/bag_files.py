"""A bag on disk: what of it can be read, what is missing, and a whole bag made of it."""

import os
import re
import shutil
import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import IO, Self

import zstandard
from ruamel.yaml import YAML
from seft_msgs_py.errors import InputError, SeftError
from seft_msgs_py.files import open_regular

from seft_ros.bags.bag_writer import METADATA, BagWriter, file_reason
from seft_ros.bags.foreign_file import ForeignFile
from seft_ros.bags.mcap_file import BagSource, McapFile, is_foreign
from seft_ros.bags.message_blocks import DamageError, MessageBlock, inflated

SUFFIXES = (".mcap", ".db3")
_MAX_METADATA = 1 << 24  # bytes
_MAX_RATIO = 1000  # of the size of a file to that of its packing; of bags it is 2 to 30

TopicName = tuple[str, str]  # name, type


class Bag:
    """A bag's messages, as far as they can be read; all is checked when it is opened.

    Metadata are not needed to read it, but say what is missing.

    Parameters
    ----------
    path : path
        A bag's folder, or a single mcap or sqlite3 file, packed or not.

    Attributes
    ----------
    sources : dict
        Name and type -> `BagSource`, of the topics in it.
    counts : Counter
        Name and type of a topic -> number of messages that can be read.
    damage : list of str
        What is wrong and what is missing; empty: nothing.
    recovered : list of str
        The same of the bag from which this one was recovered.
    checked : bool
        Whether damaged messages would be noticed: all have checksums.

    Raises
    ------
    InputError
        If there is no bag, or nothing of it can be read.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.sources: dict[TopicName, BagSource] = {}
        self.counts: Counter[TopicName] = Counter()
        self.checked = True
        self.damage: list[str] = []
        self.recovered: list[str] = []
        self._files: list[McapFile | ForeignFile] = []
        self._lacks_files = False
        self._stack = ExitStack()
        with ExitStack() as stack:
            self._claim(self._open_files(stack))
            if self.damage and not self.counts.total():
                raise InputError(f"{path}: nothing of the bag can be read: {self.fault}")
            self._stack = stack.pop_all()

    @property
    def fault(self) -> str:
        """The first line of damage, and how many more there are; empty without."""
        more = f" (and {len(self.damage) - 1} more faults)" if self.damage[1:] else ""
        return "".join(self.damage[:1]) + more

    def blocks(self, numbers: Mapping[TopicName, int]) -> Iterator[MessageBlock]:
        """Give the messages of some topics, in the order in which they were written.

        ``numbers`` are those that blocks have as the messages' sources, by name and type of the
        topic.
        """
        for file in self._files:
            wanted = {
                number: numbers[source.topic, source.type]
                for number, source in file.sources.items()
                if (source.topic, source.type) in numbers
            }
            if wanted:
                yield from file.blocks(wanted)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _open_files(self, stack: ExitStack) -> "_Metadata":
        """Open all files; give what the metadata say."""
        files = storage_files(self.path)
        metadata = _read_metadata(self.path) if self.path.is_dir() else _Metadata()
        for name in sorted(metadata.files - {file.name for file in files}):
            self._lacks_files = True
            self.damage.append(f"the file {name} is missing")
        for file in files:
            scratch = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            try:
                found = _opened(file, scratch, stack)
            except OSError as error:
                self._lacks_files = True
                self.damage.append(f"{file.name}: {file_reason(error)}")
                continue
            self._files.append(found)
            self.damage += [f"{file.name}: {one}" for one in found.damage]
            self.recovered += found.recovered
            self.checked &= found.checked
            texts = {metadata.text, found.metadata} - {""}
            if len(files) == 1 and len(texts) > 1:
                self.damage.append(f"{METADATA} is not what was written with {file.name}")
        if metadata.fault:
            self.damage.append(metadata.fault)
        return metadata

    def _claim(self, metadata: "_Metadata") -> None:
        """Compare what there is with what the files and the metadata say that there is."""
        claimed: Counter[TopicName] = Counter()
        for file in self._files:
            for number, source in file.sources.items():
                name = source.topic, source.type
                self.sources.setdefault(name, source)
                self.counts[name] += file.counts[number]
                claimed[name] += (file.claimed or {}).get(number, 0)
        stated = metadata.counts
        if self._lacks_files or any(file.claimed is None for file in self._files):
            claimed = Counter(stated)
        for name in {**self.counts, **claimed, **stated}:
            there, wanted = self.counts[name], claimed[name]
            if there < wanted:
                self.damage.append(f"{name[0]}: {wanted - there} of {wanted} messages are missing")
            elif stated and stated[name] != there:
                self.damage.append(f"{METADATA} counts {stated[name]} of {name[0]}, not {there}")


@dataclass
class _Metadata:
    """Text of metadata.yaml, the files and counts of messages in it, and what is wrong with it."""

    text: str = ""
    files: set[str] = field(default_factory=set)
    counts: Counter[TopicName] = field(default_factory=Counter)
    fault: str = ""


def _read_metadata(folder: Path) -> _Metadata:
    path, found = folder / METADATA, _Metadata()
    try:
        with open_regular(path) as file:
            raw = file.read(_MAX_METADATA + 1)
        if len(raw) > _MAX_METADATA:
            raise ValueError
        found.text = raw.decode()
        (tree,) = YAML(typ="safe").load(found.text).values()
        for row in tree["topics_with_message_count"]:
            topic = row["topic_metadata"]
            found.counts[str(topic["name"]), str(topic["type"])] += int(row["message_count"])
        found.files = {PurePath(name).name for name in tree["relative_file_paths"]}
    except FileNotFoundError:
        return _Metadata(fault=f"{METADATA} is missing")
    except Exception:  # the parser raises what garbage makes it raise
        return _Metadata(fault=f"{METADATA} can't be read")
    return found


def _opened(file: Path, scratch: Path, stack: ExitStack) -> McapFile | ForeignFile:
    """Open a file of a bag; what is wrong with its packing is damage of the file."""
    stream, fault = stack.enter_context(open_regular(file)), ""
    if file.suffix == ".zstd":
        packed, file = stream, scratch / f"unpacked{storage_suffix(file)}"
        stream = stack.enter_context(file.open("x+b"))
        fault = _unpack(packed, stream)
        stream.flush()
    is_ours = file.suffix == ".mcap" and not is_foreign(stream)
    found = McapFile(stream) if is_ours else ForeignFile(file, scratch)
    found.damage[:0] = [fault] if fault else []
    if isinstance(found, ForeignFile):
        stack.callback(found.close)
    return found


def _unpack(packed: IO[bytes], plain: IO[bytes]) -> str:
    """Decompress a file, to no more than a bag can have; say what is wrong, empty if nothing is."""
    size, free = os.fstat(packed.fileno()).st_size, shutil.disk_usage(plain.fileno()).free
    try:
        declared = zstandard.frame_content_size(packed.read(32))
        packed.seek(0)
        for part in inflated(packed, min(_MAX_RATIO * size, free)):
            plain.write(part)
    except DamageError as error:
        return str(error)
    except zstandard.ZstdError:
        return "it is packed, and the packing is damaged"
    return "it is packed and cut off" if plain.tell() < declared else ""


def storage_files(path: str | Path) -> list[Path]:
    """List the files of a bag that hold messages, in the order in which they were written.

    Raises
    ------
    InputError
        If there is no such path, or no bag there.
    """
    path = Path(path)
    try:
        if path.is_dir():
            found = [file for file in path.iterdir() if storage_suffix(file) in SUFFIXES]
            if found or (path / METADATA).exists():
                return sorted(found, key=_natural_order)
            raise InputError(f"{path}: no bag: the folder has no mcap or db3 file")
        if not path.exists():
            raise InputError(f"{path}: there is no such bag")
    except OSError as error:
        raise InputError(f"{path}: {file_reason(error)}") from None
    if storage_suffix(path) not in SUFFIXES:
        raise InputError(f"{path}: not a bag; give a bag's folder, or an mcap or db3 file")
    return [path]


def storage_suffix(file: Path) -> str:
    """Give the suffix that names the format: ``.mcap`` of ``x.mcap`` and ``x.mcap.zstd``."""
    return file.with_suffix("").suffix if file.suffix == ".zstd" else file.suffix


def _natural_order(file: Path) -> list[tuple[int, str]]:
    """Sort bag_2 before bag_10."""
    parts = re.split(r"(\d+)", file.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


@dataclass(frozen=True)
class Recovery:
    """What `recover_bag` did with a bag; an intact one was left unchanged."""

    path: Path  # of the whole bag
    messages: int  # in it now
    damage: list[str]  # what was wrong with it
    original: Path | None  # where the damaged original is kept; None if it was intact
    checked: bool  # see `Bag`

    def __str__(self) -> str:
        if self.original is None:
            known = "" if self.checked else ", without checksums: changed ones are not noticed"
            return f"{self.path} is intact ({self.messages} messages{known}); nothing was done"
        kept = f"the damaged original is kept as {self.original}"
        now = f"{self.path} now is a bag of the {self.messages} messages that can be read; {kept}"
        return "\n".join([*self.damage, now])


def recover_bag(path: str | Path) -> Recovery:
    """Make a whole bag of what can be read of a damaged one, at the same path.

    The bag is written beside the original in ``<name>.recovering``; when it is complete the
    original becomes ``<name>.cut`` and the bag takes its place. What is missing stands in the new
    bag, too. A single file becomes an mcap file.

    Parameters
    ----------
    path : path
        As of a `Bag`.

    Raises
    ------
    InputError
        If there is no bag, nothing of it can be read, ``<name>.cut`` exists, or the disk fails;
        the original is then unchanged.
    """
    path = Path(path)
    place = Path(os.path.realpath(path))
    cut, fresh = place.with_name(place.name + ".cut"), place.with_name(place.name + ".recovering")
    storage_files(place)
    name, final, whole = place.name, place, fresh / place.name
    if not place.is_dir():
        name = name.removesuffix(".zstd").removesuffix(storage_suffix(place))
        final = place.with_name(f"{name}.mcap")
        whole = fresh / name / final.name
    with Bag(path) as bag:
        if not bag.damage:
            return Recovery(path, bag.counts.total(), [], None, bag.checked)
        damage = bag.recovered + bag.damage
        for taken in {cut, final} - {place}:
            if taken.exists():
                raise InputError(f"{taken} is in the way; move it elsewhere")
        try:
            shutil.rmtree(fresh, ignore_errors=True)
            with BagWriter(fresh / name, damage) as writer:
                sources = list(bag.sources.values())
                numbers = {name: number for number, name in enumerate(bag.sources)}
                for block in bag.blocks(numbers):
                    for number, time_ns, raw in block.messages():
                        writer.add(sources[number], time_ns, raw)
            place.rename(cut)
            try:
                whole.rename(final)
            except BaseException:
                cut.rename(place)
                raise
        except (OSError, SeftError) as error:
            reason = file_reason(error) if isinstance(error, OSError) else error
            raise InputError(f"{path}: it can't be recovered ({reason}); it is as it was") from None
        finally:
            if place.exists() or final.exists():
                shutil.rmtree(fresh, ignore_errors=True)
        return Recovery(final, bag.counts.total(), damage, cut, checked=True)
