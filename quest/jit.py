"""The decorator of all compiled loops: the only module of the package that imports numba."""

from __future__ import annotations

import gc
import hashlib
import logging
import pickle
import sys
import warnings
from collections.abc import Callable
from functools import cache, partial, wraps
from pathlib import Path
from typing import Any, TypeVar, cast

try:
    with warnings.catch_warnings():
        # It reads numbers in the environment, and goes on with a warning of many lines where one is none.
        warnings.filterwarnings("error", "Environment variable 'NUMBA_", RuntimeWarning)
        import numba
        from numba import extending
        from numba.core import codegen, serialize
        from numba.core.compiler import CompileResult
        from numba.core.runtime.nrt import rtsys
except (ValueError, RuntimeWarning) as error:  # ValueError: NUMBA_NUM_THREADS=0
    cause = str(error).splitlines()[0]
    raise ImportError(f"numba does not start: {cause} (look at the variables NUMBA_*)") from error

from quest import machine_code

#: numba states no types for these.
_njit: Any = numba.njit
_jitable: Any = cast("Any", extending).register_jitable
_rebuild: Any = CompileResult._rebuild
_dumps: Any = serialize.dumps
_llvm: Any = cast("Any", codegen).ll
_Library: Any = codegen.CPUCodeLibrary

#: numba's name and features of the processor where it compiles for all processors, see quest.compile.
_ANY_PROCESSOR = ("generic", "")

Function = TypeVar("Function", bound=Callable[..., object])


#: The sources that loops of other folders may use.
_ROBUST = Path(__file__).parent / "robust"
_SHARED = (Path(__file__), Path(__file__).parent / "algebra.py")


@cache
def _hash_of(*folders: Path) -> str:
    files = {*_SHARED, *_ROBUST.rglob("*.py"), *(path for folder in folders for path in folder.glob("*.py"))}
    return hashlib.sha256(b"".join(path.read_bytes() for path in sorted(files))).hexdigest()


def compiler_of(*folders: Path, reorders_sums: bool = False, part: bool = False) -> Callable[[Function], Function]:
    """The decorator for the compiled loops of the first folder, which call those of the others.

    A hash of all sources of the folders, and of the loops of quest, is a part of the name under which machine code is
    kept: an edit of any of these files renews the machine code of all loops. A loop may call loops of these only.

    * ``reorders_sums``: Whether sums may be reordered, and fused with products, as for the vectors of a processor.
    * ``part``: Whether only other loops call the functions. What lets Python call one takes .04 to .2 s to compile.
    * Returns: Compiles a function of numbers and arrays, in the part of Python that numba compiles, at its first call,
      and keeps the machine code on disk (:mod:`quest.machine_code`). Where no folder can be written,
      each process compiles for itself.
    """
    sources, kept = _hash_of(*folders), machine_code.folders_of(folders[0])
    fast = {"reassoc", "contract"} if reorders_sums else False

    def _compiled(function: Function) -> Function:
        # No loop is called through a pointer, and none holds the lock of the interpreter.
        dispatcher = _njit(
            error_model="numpy", fastmath=fast, no_cfunc_wrapper=True, no_cpython_wrapper=part, nogil=True
        )(function)
        if dispatcher is not function:  # NUMBA_DISABLE_JIT is not set
            dispatcher._cache = _Cache(f"{function.__module__}.{function.__qualname__}", sources, kept)
            dispatcher._compiler.compile = _quickly(dispatcher._compiler.compile)
        return cast("Function", dispatcher)

    return _compiled


def inlined(function: Function) -> Function:
    """The decorator for a function that becomes a part of each loop that calls it; Python calls it as it is written.

    A call that passes arrays takes as long as some hundred operations, since each of its arrays counts its users. Here
    nothing is counted. So the function must not make arrays, and neither must the loops that it calls.
    """
    return cast(
        "Function", _jitable(error_model="numpy", forceinline=True, no_cpython_wrapper=True, _nrt=False)(function)
    )


def _quickly(compile_: Callable[..., object]) -> Callable[..., object]:
    """Compile in three quarters of the time, by what is left out while numba holds its lock.

    * The collector of garbage: the compiler makes 300 000 objects that live on.
    * Two of the three rounds of optimization, which let numba count the users of arrays less often. No loop is slower.
    """

    @wraps(compile_)
    def _compile(*arguments: object) -> object:
        _announce_once()
        collecting, rounds = gc.isenabled(), (_Library._optimize_functions, _Library._optimize_final_module)
        gc.disable()
        _Library._optimize_functions, _Library._optimize_final_module = _lay_out, _optimize
        try:
            return compile_(*arguments)
        finally:
            _Library._optimize_functions, _Library._optimize_final_module = rounds
            if collecting:
                gc.enable()

    return _compile


def _lay_out(library: Any, module: Any) -> None:
    module.data_layout = library._codegen._data_layout


def _optimize(library: Any) -> None:
    passes, builder = library._codegen._module_pass_manager()
    passes.run(library._final_module, builder)


@cache
def _announce_once() -> None:
    """Tell a person who waits that loops are compiled; on stderr, unless the program handles the logger ``quest``."""
    logging.getLogger("quest").warning("compiling what no run on this machine has needed yet: up to two minutes")


class _Cache:
    """The machine code of a loop on disk, in place of numba's own cache: the methods are those that numba calls.

    numba's cache lists the files of a loop in an index. Two processes that compile a loop for different signatures at
    once may overwrite each other's files, and then call the machine code of the wrong signature. numba also loads all
    that it needs to compile, and scipy with it, before it reads a file: .2 s, half of the first call of a process.
    """

    def __init__(self, name: str, sources: str, folders: tuple[Path, ...]) -> None:
        self.cache_path = str(folders[0])
        self._name, self._folders = name, folders
        self._parts = (name, sources, numba.__version__, sys.implementation.cache_tag, sys.abiflags)

    def _file(self, signature: object, processor: tuple[str, ...]) -> str:
        return machine_code.name_of(self._name, (*self._parts, signature, processor))

    def load_overload(self, signature: object, context: Any) -> object | None:
        """The machine code of a signature for this processor, or for any; None where there is none on disk."""
        processor = context.codegen().magic_tuple()
        data = machine_code.read(self._folders, self._file(signature, processor))
        data = data or machine_code.read(self._folders, self._file(signature, (processor[0], *_ANY_PROCESSOR)))
        if data is None:
            return None
        rtsys.initialize(context)  # what the machine code calls to allocate arrays
        parts, bitcode = pickle.loads(data)
        library, function, *rest = pickle.loads(parts)
        context.codegen()._engine._defined_symbols.add(function.llvm_cpython_wrapper_name)
        result: Any = _rebuild(context, library, function, *rest)
        # A loop that is compiled later may contain this one. To read all bitcode takes a third of a first call.
        result.library._get_module_for_linking = partial(_llvm.parse_bitcode, bitcode)
        return cast("object", result)

    def save_overload(self, signature: object, result: Any) -> None:
        """Keep machine code."""
        if not result.library.has_dynamic_globals:  # addresses in this process
            (name, kind, (code, bitcode)), *rest = result._reduce()
            parts = _dumps(((name, kind, (code, _nothing())), *rest))
            machine_code.write(
                self._folders, self._file(signature, result.codegen.magic_tuple()), pickle.dumps((parts, bitcode))
            )

    def flush(self) -> None:
        """Nothing: a changed source has a name of its own."""


@cache
def _nothing() -> bytes:
    """The bitcode of an empty module."""
    return cast("bytes", _llvm.parse_assembly("").as_bitcode())


#: The folder of the loops of quest, and the decorators of these loops.
FOLDER = _ROBUST / "kernels"
compiled = compiler_of(FOLDER)
#: For what only other loops call.
part = compiler_of(FOLDER, part=True)
