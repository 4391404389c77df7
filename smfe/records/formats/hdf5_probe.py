"""The process that opens HDF5 files first: whatever a damaged one does to the library, it does it here.

Run as a script by `formats.hdf5_guard`, never imported: it reads names of files from its input, one in a line as
JSON, walks through everything but the samples, and answers with a line. It imports h5py and nothing of smfe, so that it
starts quickly.
"""

import contextlib
import json
import sys

import h5py

_SMALL = 1 << 16
"""Data sets of fewer bytes are read: names of axes, scalars, texts."""

_MOST_MEMORY = 4 << 30


def _limit_memory() -> None:
    """Let a header that states huge numbers fail here instead of filling the memory; not on Windows."""
    try:
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY, _MOST_MEMORY))
    except (ImportError, ValueError, OSError):
        pass


def _attributes(item: h5py.HLObject) -> None:
    for name in item.attrs:
        with contextlib.suppress(Exception):
            item.attrs[name]


def _visit(item: object, seen: set[int]) -> None:
    """Look at an object and what is in it; one that cannot be opened does not keep from its neighbours."""
    if not isinstance(item, h5py.HLObject) or (at := h5py.h5o.get_info(item.id).addr) in seen:
        return
    seen.add(at)
    for look in (_attributes, _scales, _index, _content) if isinstance(item, h5py.Dataset) else (_attributes,):
        with contextlib.suppress(Exception):
            look(item)
    if isinstance(item, h5py.Group):
        for name in item:
            with contextlib.suppress(Exception):
                _visit(item[name], seen)


def _scales(item: h5py.Dataset) -> None:
    for dimension in item.dims:
        len(dimension)
        dimension.values()


def _index(item: h5py.Dataset) -> None:
    item.id.get_storage_size()
    if item.chunks is not None:
        item.id.get_num_chunks()


def _content(item: h5py.Dataset) -> None:
    if item.size and item.size * item.dtype.itemsize <= _SMALL:
        item[()]


def _walk(path: str) -> None:
    # Whatever is raised here the reader meets as well, and says.
    with contextlib.suppress(Exception), h5py.File(path, "r") as file:
        _visit(file, set())
        file.visititems(lambda name, item: None)


def main() -> None:
    """Answer every line of the input with one of the output."""
    _limit_memory()
    _say("ready")
    for line in sys.stdin:
        _walk(json.loads(line))
        _say("done")


def _say(word: str) -> None:
    sys.stdout.write(word + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
