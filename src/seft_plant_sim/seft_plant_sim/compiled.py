"""Machine code of the steps, cached on disk, and array functions that the steps share."""

import fcntl
import hashlib
import math
import os
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm
import numba as typed_numba
import numpy as np
from numba.core import caching
from seft_msgs_py.arrays import Floats, Ints

numba: Any = typed_numba  # older versions have no types
# most loops run over few axes, so that loop vectorisation costs more than it saves; vectorisation
# of successive statements is off by default
numba.config.LOOP_VECTORIZE, numba.config.SLP_VECTORIZE = 0, 1
numba.config.OPT = type(numba.config.OPT)(1)  # the code is as fast as of level 3, and sooner made
llvm.set_option("seft", "-disable-lsr")  # a pass that takes minutes in LLVM 14, and saves nothing
_entry_points: dict[Hashable, Callable[..., Any]] = {}
OPTIONS = {"error_model": "numpy", "forceinline": True, "_nrt": False, "no_cfunc_wrapper": True}


def compiled[F: Callable[..., Any]](function: F, *, nogil: bool = False, inline: bool = True) -> F:
    """Compile a function of arrays and numbers at its first call, or read it from the disk.

    No operation is reordered or fused, so that the function gives the same bits wherever it is
    called from. It can't make arrays: reference counting takes longer than a step. Where the
    disk can't be written to, it is compiled anew in each process. With numba's NUMBA_DISABLE_JIT
    it stays as it is.

    Parameters
    ----------
    function : callable
        The function.
    nogil : bool
        Whether it releases the interpreter's lock when Python calls it.
    inline : bool
        Whether its code is repeated wherever it is called: faster, but longer to compile.
    """
    if numba.config.DISABLE_JIT:
        return function
    made = numba.njit(nogil=nogil, **OPTIONS | {"forceinline": inline})(function)
    template = made.get_call_template
    made.get_call_template = lambda arguments, named: template(  # not anew for each constant
        [numba.types.unliteral(argument) for argument in arguments], named
    )
    with suppress(RuntimeError):  # it can't be written to
        made._cache = _CACHE(function)
        made._cache.load_overload = _telling(made._cache.load_overload)
    return made


class _ByText(caching._CacheLocator):
    """Where numba keeps the machine code of a function: by the texts on which it may depend.

    numba itself uses the path of the function's file, and the text of that file alone.
    """

    def __init__(self, function: Any, file: str) -> None:
        self._file, self._line = Path(file), function.__code__.co_firstlineno

    @classmethod
    def from_function(cls, function: Any, file: str) -> Any:
        found: Any = cls(function, file)
        try:
            found.ensure_cache_path()
        except OSError:
            return None
        return found

    def get_cache_path(self) -> str:
        return str(code_folder(self._file.parent))

    def get_source_stamp(self) -> str:
        return ""  # the folder's name depends on the text

    def get_disambiguator(self) -> str:
        return f"{self._file.parent.name}-{self._line}"


_PLACES = type("Places", (caching.CompileResultCacheImpl,), {"_locator_classes": [_ByText]})
_CACHE = type("Cache", (caching.FunctionCache,), {"_impl_class": _PLACES})
_listeners: list[Callable[[], None]] = []


def tell_of_compilation(tell: Callable[[], None]) -> None:
    """Call a function once, when this process finds no machine code on the disk."""
    _listeners[:] = [tell]


def _telling(load: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a cache's way to load machine code."""

    def loaded(signature: Any, context: Any) -> Any:
        found = load(signature, context)
        if found is None and _listeners:
            _listeners.pop()()
        return found

    return loaded


def entry_point(function: Any, *arguments: Any, kind: Hashable = None) -> Callable[..., Any]:
    """Give the machine code of a compiled function for arguments of these types.

    A direct call skips numba's check of each argument's type, which takes longer than a step. The
    caller must give arguments of the same types, and contiguous arrays. A known ``kind`` of the
    arguments that may differ, see `kind_of`, saves finding it.
    """
    if numba.config.DISABLE_JIT:
        return function
    key = function, kind or kind_of(arguments)
    if (found := _entry_points.get(key)) is None:  # numba's check takes thousands of steps' time
        signature = tuple(numba.typeof(argument) for argument in arguments)
        with _one_at_a_time(function, signature):
            function.compile(signature)
        found = _entry_points[key] = function.overloads[signature].entry_point
    return found


def is_at_hand(function: Any, *arguments: Any, kind: Hashable = None) -> bool:
    """Say whether the code of `entry_point` was asked for before, so that it need not be made."""
    if numba.config.DISABLE_JIT:
        return False
    known = (function, kind or kind_of(arguments)) in _entry_points
    return known or _lock_of(function, tuple(map(numba.typeof, arguments))).exists()


def _lock_of(function: Any, signature: Any) -> Path:
    """File that a process locks while it makes machine code; it stays."""
    name = hashlib.sha256(f"{function.py_func.__qualname__} {signature}".encode()).hexdigest()
    folder = code_folder(Path(function.py_func.__code__.co_filename).parent)
    return folder / f"{name[:16]}.lock"


@contextmanager
def _one_at_a_time(function: Any, signature: Any) -> Iterator[None]:
    """Make processes that need the same machine code wait for the first, and read what it made."""
    path = _lock_of(function, signature)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = path.open("wb")
    except OSError:  # where nothing can be written, each process compiles for itself
        yield
        return
    with lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


_ROWS, _COLUMNS, _OTHER = 0x1, 0x2, 0x100 | 0x400
"""Numpy's flags of contiguous rows, contiguous columns; aligned and writeable."""


def kind_of(argument: Any) -> Any:
    """Give what numba's type of an argument depends on."""
    if isinstance(argument, np.ndarray):
        flags = argument.flags.num
        layout = flags & _ROWS or flags & _COLUMNS
        return argument.dtype.char, argument.ndim, layout | flags & _OTHER
    if isinstance(argument, tuple):
        return type(argument), *map(kind_of, argument)
    return type(argument)


@lru_cache
def code_folder(folder: Path) -> Path:
    """Folder for the machine code of a folder's package, which may also use this package's code."""
    while (folder.parent / "__init__.py").exists():
        folder = folder.parent
    texts = hashlib.sha256(numba.__version__.encode())
    packages = sorted({folder, Path(__file__).parent})  # a set's order differs between processes
    for package in packages:
        for file in sorted(package.rglob("*.py")):
            texts.update(file.read_bytes())
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return home / "seft" / texts.hexdigest()[:16]


def places(*counts: int) -> list[tuple[int, ...] | Ints]:
    """Give 0 to count - 1 for each count; where all are 1, a step has machine code of its own.

    The length of a tuple is known when a step is compiled, and a loop over one place is none, which
    saves most of the time of a test of one axis. All others share one machine code.
    """
    return [(0,) if max(counts) == 1 else np.arange(count) for count in counts]


@compiled
def multiply(transposed: Floats, vector: Floats, result: Floats) -> None:
    """Multiply a matrix, given transposed, by a vector."""
    columns, rows = transposed.shape
    multiply_sized(columns, rows, transposed, vector, result)


@compiled
def multiply_sized(
    columns: int, rows: int, transposed: Floats, vector: Floats, result: Floats
) -> None:
    """Do what `multiply` does, faster if the sizes are known at compilation.

    The length of a tuple is known then, that of an array is not.
    """
    for first in range(0, rows if rows >= 4 else 0, 4):  # four at a time, in one instruction each,
        i = min(first, rows - 4)  # at the end some of them again
        one = two = three = four = 0.0
        for j in range(columns):
            factor = vector[j]
            one += transposed[j, i] * factor
            two += transposed[j, i + 1] * factor
            three += transposed[j, i + 2] * factor
            four += transposed[j, i + 3] * factor
        result[i], result[i + 1], result[i + 2], result[i + 3] = one, two, three, four
    for i in range(rows if rows < 4 else 0):
        one = 0.0
        for j in range(columns):
            one += transposed[j, i] * vector[j]
        result[i] = one


@compiled
def dot(count: int, left: Floats, right: Floats) -> float:
    """Sum the products of the first values of two arrays, in four sums that do not wait."""
    whole = count - count % 4
    one = two = three = four = 0.0
    for j in range(0, whole, 4):
        one += left[j] * right[j]
        two += left[j + 1] * right[j + 1]
        three += left[j + 2] * right[j + 2]
        four += left[j + 3] * right[j + 3]
    for j in range(whole, count):
        one += left[j] * right[j]
    return (one + two) + (three + four)


@compiled
def copy(count: int, source: Floats, result: Floats) -> None:
    """Copy the first values of an array."""
    whole = count - count % 4
    for i in range(0, whole, 4):
        one, two, three, four = source[i], source[i + 1], source[i + 2], source[i + 3]
        result[i], result[i + 1], result[i + 2], result[i + 3] = one, two, three, four
    for i in range(whole, count):
        result[i] = source[i]


@compiled
def smooth_sign(x: float) -> float:
    """Give tanh(x), by one exponential."""
    if abs(x) > 20.0:
        return math.copysign(1.0, x)
    faded = math.exp(-2.0 * abs(x))
    return math.copysign((1.0 - faded) / (1.0 + faded), x)


@compiled
def bounded(value: float, limit: float) -> float:
    """Keep a value between -limit and limit."""
    value = limit if value > limit else value
    return -limit if value < -limit else value


@compiled
def put_first(line: Floats, value: float) -> None:
    """Put a value before all others of a line, whose last one is lost."""
    for j in range(len(line)):  # upwards: the compiler knows that no place is negative
        line[j], value = value, line[j]


@compiled
def is_finite(values: Floats, first: int) -> bool:
    """Say whether all values of an array of two dimensions are finite, from its first row on."""
    for row in range(first, values.shape[0]):
        for i in range(values.shape[1]):
            if not math.isfinite(values[row, i]):
                return False
    return True
