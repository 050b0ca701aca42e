"""Loops read call frames where jaxlib's header puts things, and refuse wrong ones."""

import re
import time
from importlib.metadata import version
from pathlib import Path

import jax
import jax.numpy as jnp
import jaxlib
import numpy as np
import pytest

from jaxgrow.kernels import ffi
from jaxgrow.kernels.arguments import Argument, codes_of, DATA_TYPES
from jaxgrow.kernels.layout import NEAR_ARGUMENTS, NEAR_RESULTS


pytest.importorskip("numba")

from numba import cfunc, njit

from jaxgrow.kernels import frames


HEADER = Path(jaxlib.__file__).parent / "include/xla/ffi/api/c_api.h"


class Header:
    """What the header says, as a C compiler for 64 bits understands it."""

    def __init__(self, text):
        text = re.sub(r"//[^\n]*|/\*.*?\*/", "", text, flags=re.DOTALL)
        text = re.sub(r"_XLA_FFI_API_STRUCT_FIELD\((\w+)\)", r"\1* \1", text)
        self.values = {
            name: int(value)
            for name, value in re.findall(r"\b(XLA_FFI_\w+) = (\d+)", text)
        }
        self.values |= {
            name: int(value)
            for name, value in re.findall(r"#define (XLA_FFI_\w+) (\d+)\s", text)
        }
        self.enums = set(re.findall(r"\}\s*(XLA_FFI_\w+);", text))
        self.structs = {
            name: self._fields(body)
            for name, body in re.findall(r"struct (\w+) \{(.*?)\}", text, re.DOTALL)
        }
        self.enums -= set(self.structs)

    @staticmethod
    def _fields(body):
        """Pairs of a type (with a star for pointers) and a name."""
        body = re.sub(r"\w+\s*\(\*(\w+)\)\([^)]*\)", r"void* \1", body)
        found = []
        for line in filter(None, map(str.strip, body.split(";"))):
            kind, name = re.fullmatch(r"(.*?[\s*])(\w+)", line, re.DOTALL).groups()
            kind = re.sub(r"\b(const|struct)\b|\s", "", kind)
            found.append((kind, name))
        return found

    def _extent(self, kind):
        """Size and alignment."""
        if kind.endswith("*") or kind in ("size_t", "int64_t"):
            return 8, 8
        if kind in self.enums or kind in ("int", "int32_t", "XLA_FFI_Handler_Traits"):
            return 4, 4
        place, widest = 0, 1
        for field, _ in self.structs[kind]:
            size, alignment = self._extent(field)
            place += -place % alignment + size
            widest = max(widest, alignment)
        return place + -place % widest, widest

    def place(self, struct, *path):
        """Where a field begins, in bytes; of one in a struct there, likewise."""
        place = 0
        for kind, name in self.structs[struct]:
            size, alignment = self._extent(kind)
            place += -place % alignment
            if name == path[0]:
                return place + (self.place(kind, *path[1:]) if path[1:] else 0)
            place += size
        raise KeyError(path)

    def end(self, struct, field):
        """Where it ends: the size that a struct is said to have by its last field."""
        kind = dict(map(reversed, self.structs[struct]))[field]
        return self.place(struct, field) + self._extent(kind)[0]


@pytest.fixture(scope="module")
def header():
    if not HEADER.exists():
        pytest.skip(f"jaxlib {version('jaxlib')} is shipped without c_api.h")
    return Header(HEADER.read_text())


FRAME, BUFFER, API = "XLA_FFI_CallFrame", "XLA_FFI_Buffer", "XLA_FFI_Api"
ERROR = "XLA_FFI_Error_Create_Args"


@pytest.mark.parametrize(
    "word, struct, path",
    [
        ("EXTENSION", FRAME, ["extension_start"]),
        ("API", FRAME, ["api"]),
        ("ARGUMENT_COUNT", FRAME, ["args", "size"]),
        ("ARGUMENTS", FRAME, ["args", "args"]),
        ("RESULT_COUNT", FRAME, ["rets", "size"]),
        ("RESULTS", FRAME, ["rets", "rets"]),
        ("TYPE", BUFFER, ["dtype"]),
        ("DATA", BUFFER, ["data"]),
        ("RANK", BUFFER, ["rank"]),
        ("DIMENSIONS", BUFFER, ["dims"]),
        ("EXTENSION_TYPE", "XLA_FFI_Extension_Base", ["type"]),
        ("METADATA", "XLA_FFI_Metadata_Extension", ["metadata"]),
        ("VERSION_OF_METADATA", "XLA_FFI_Metadata", ["api_version", "major_version"]),
        ("VERSION_OF_API", API, ["api_version", "major_version"]),
        ("MAKE_ERROR", API, ["XLA_FFI_Error_Create"]),
        ("MESSAGE", ERROR, ["message"]),
        ("ERROR_CODE", ERROR, ["errc"]),
    ],
)
def test_word_lies_where_the_header_puts_it(header, word, struct, path):
    assert 8 * getattr(frames, word) == header.place(struct, *path)


def test_minor_version_lies_above_the_major_one(header):
    major, minor = (
        header.place("XLA_FFI_Api_Version", f"{name}_version")
        for name in ("major", "minor")
    )
    assert (major % 8, minor - major) == (0, 4)


def test_numbers_are_those_of_the_header(header):
    assert header.values["XLA_FFI_API_MAJOR"] == frames.MAJOR
    assert header.values["XLA_FFI_Extension_Metadata"] == frames.QUERY_OF_VERSION
    for name in ("INVALID_ARGUMENT", "INTERNAL"):
        assert header.values[f"XLA_FFI_Error_Code_{name}"] == getattr(frames, name)
    assert header.end(ERROR, "errc") == frames.ERROR_SIZE


@pytest.mark.parametrize("dtype", DATA_TYPES, ids=str)
def test_type_has_the_number_of_the_header(header, dtype):
    name = {"b": "PRED", "i": "S", "u": "U", "f": "F"}[dtype.kind]
    name += "" if dtype.kind == "b" else str(8 * dtype.itemsize)
    assert header.values[f"XLA_FFI_DataType_{name}"] == DATA_TYPES[dtype]


def test_header_is_read_as_a_compiler_reads_it():
    known = Header(
        """
        typedef enum { XLA_FFI_Kind_ONE = 1, } XLA_FFI_Kind;
        struct Inner { size_t struct_size; /* a; b; */ int major; };  // int c;
        struct Outer {
          XLA_FFI_Kind kind;
          struct Inner inner;
          int32_t three; int32_t four;
          void (*deleter)(void* object);
          const struct Outer* next;
        };"""
    )
    fields = ["kind", "inner", "three", "four", "deleter", "next"]
    assert [known.place("Outer", name) for name in fields] == [0, 8, 24, 28, 32, 40]
    assert known.place("Outer", "inner", "major") == 16


GIVEN = jnp.zeros((4, 3)), jnp.full((4, 2), 4, jnp.int32), jnp.ones(1)
MADE = jax.ShapeDtypeStruct((5, 4), np.int32), jax.ShapeDtypeStruct((1,), np.int32)


@pytest.mark.parametrize(
    "given, made, sentence",
    [
        (
            (GIVEN[0].astype(np.float32), *GIVEN[1:]),
            MADE,
            "argument 0 is float32 of rank 2; it must be float64 of rank 2",
        ),
        (
            (*GIVEN[:2], jnp.ones(())),
            MADE,
            "argument 2 is float64 of rank 0; it must be float64 of rank 1",
        ),
        (
            (GIVEN[0], GIVEN[1].astype(jnp.bfloat16), GIVEN[2]),
            MADE,
            "argument 1 is type 16 of rank 2; it must be int32 of rank 2",
        ),
        (
            GIVEN,
            (MADE[0], jax.ShapeDtypeStruct((1,), np.int64)),
            "result 1 is int64 of rank 1; it must be int32 of rank 1",
        ),
        ((*GIVEN, GIVEN[2]), MADE, "not as many arguments and results"),
        (GIVEN, MADE[:1], "not as many arguments and results"),
    ],
)
def test_call_that_is_not_as_declared_is_an_exception(given, made, sentence):
    assert ffi.registered("near")
    call = jax.ffi.ffi_call(ffi.target("near"), made)
    with pytest.raises(
        jax.errors.JaxRuntimeError, match=f"INVALID_ARGUMENT.*{sentence}"
    ):
        jax.block_until_ready(call(*given))


def test_handler_may_fail_with_a_sentence_of_its_own():
    sentence = frames.text("the loop lost its way.")

    @cfunc(frames.HANDLER)
    def lost(frame):
        if frames.answers_version(frame):
            return 0
        return frames.fail(frame, frames.INTERNAL, sentence)

    capsule = ffi._new_capsule(lost.address, None, None)
    jax.ffi.register_ffi_target("jaxgrow_test_lost", capsule, platform="cpu")
    call = jax.ffi.ffi_call("jaxgrow_test_lost", MADE[1])
    for _ in range(3):
        with pytest.raises(jax.errors.JaxRuntimeError, match=r"INTERNAL.*its way\."):
            jax.block_until_ready(call())


class Frame:
    """A call frame, made by hand."""

    def __init__(self, arguments, results):
        self._alive = []
        words = np.zeros(20, np.int64)
        for count, buffers, declared in (
            (frames.ARGUMENT_COUNT, frames.ARGUMENTS, arguments),
            (frames.RESULT_COUNT, frames.RESULTS, results),
        ):
            words[count] = len(declared)
            words[buffers] = self._keep(np.array([self._buffer(d) for d in declared]))
        self.address = self._keep(words)

    def _keep(self, array):
        self._alive.append(array)
        return array.ctypes.data

    def _buffer(self, declared):
        buffer = np.zeros(6, np.int64)
        buffer[frames.TYPE] = DATA_TYPES[declared.dtype]
        buffer[frames.RANK] = declared.rank
        return self._keep(buffer)


def test_every_argument_and_result_is_compared():
    declared = [*NEAR_ARGUMENTS, *NEAR_RESULTS]
    codes = codes_of(NEAR_ARGUMENTS, NEAR_RESULTS)
    split = len(NEAR_ARGUMENTS)
    assert (
        frames.mismatch(Frame(declared[:split], declared[split:]).address, codes) == 0
    )
    for k, one in enumerate(declared):
        for odd in (
            Argument(one.name, np.float16, one.rank),
            Argument(one.name, one.dtype, one.rank + 1),
        ):
            other = [*declared[:k], odd, *declared[k + 1 :]]
            frame = Frame(other[:split], other[split:])
            assert frames.mismatch(frame.address, codes) >> 32 == k + 1


def test_check_of_a_hundred_buffers_takes_less_than_a_microsecond():
    many = [Argument(f"a{k}", np.float64, k % 3) for k in range(59)]
    frame, codes = Frame(many, many[:45]), codes_of(many, many[:45])

    @njit
    def often(address, codes, count):
        found = 0
        for _ in range(count):
            found += frames.mismatch(address, codes)
        return found

    assert often(frame.address, codes, 1) == 0
    took = []
    for _ in range(5):
        start = time.perf_counter()
        often(frame.address, codes, 10_000)
        took.append((time.perf_counter() - start) / 10_000)
    assert min(took) < 1e-6
