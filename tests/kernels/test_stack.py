"""The stack that machine code needs does not grow with a program.

A thread has 8 MB, or as little as 512 kB. A received program may be as long as
`pfdist.models.written` allows, so whatever grows with it lies in memory of the caller.
"""

import re
import threading
from functools import partial

import numpy as np
import pytest

from oracles.computed import assembly, called
from pfdist.kernels.blocks import Source, compile_blocks
from pfdist.kernels.lowering import module_of, split
from pfdist.models.program import MASKS, MOST_IN_STEP, TAKES, Operation, Program, merged
from pfdist.models.symbols import MOST_OPERATIONS
from pfdist.models.tracing import Traced

MOST = 64 * 1024  # bytes of a frame
LAYOUT = {"x": ("slots", 0)}
PROCESSORS = {
    "haswell": "x86_64-unknown-linux-gnu",
    "skylake-avx512": "x86_64-unknown-linux-gnu",
    "neoverse-n1": "aarch64-unknown-linux-gnu",
}
slow = partial(pytest.param, marks=pytest.mark.slow)
STEPS = Operation("constant", (), 0)


def x(number):
    return Operation("x", (), number)


def program(operations, outputs=None, constants=((3.0,),)):
    outputs = (len(operations) - 1,) if outputs is None else tuple(outputs)
    return merged(Program(tuple(operations), outputs, np.array(constants), (np.arange(5.0),)))


def chained(operations, size):
    """So many more operations, each of which takes the last value, and one of long before."""
    first = len(operations) - 1
    for k in range(len(operations), len(operations) + size):
        name = ("add", "fmin", "subtract")[k % 3]
        operations.append(Operation(name, (k - 1, max(first, k - 700))))
    return operations


def chain(size):
    return program(chained([x(0)], size))


def long_step(size):
    """A loop with a long step."""
    begin = [x(0), STEPS, Operation("repeat", (1, 0, 0), 3), Operation("state", (2,), 1)]
    operations = chained([*begin, Operation("state", (2,), 0)], size)
    last = len(operations) - 1
    operations += [Operation("again", (2, last, last - 1)), Operation("final", (last + 1,), 0)]
    return program(operations)


def entries(size):
    """Each step of a loop takes one of many values."""
    operations = chained([STEPS, x(0)], size)
    loop, values = len(operations), range(2, size + 2)
    operations += [Operation("repeat", (0, 1), size), Operation("state", (loop,), 0)]
    operations += [Operation("nth", (loop, *values)), Operation("add", (loop + 1, loop + 2))]
    return program(
        [*operations, Operation("again", (loop, loop + 3)), Operation("final", (loop + 4,), 0)]
    )


def states(size):
    """The many states of a loop go round."""
    loop, end = size + 1, 2 * size + 2
    operations = [*map(x, range(size)), STEPS, Operation("repeat", (size, *range(size)), 3)]
    operations += [Operation("state", (loop,), (k + 1) % size) for k in range(size)]
    operations.append(Operation("again", (loop, *range(loop + 1, end))))
    operations += [Operation("final", (end,), k) for k in range(size)]
    return program(operations, range(end + 1, end + 1 + min(size, 1000)))


def shared(size):
    """Many numbers are the same for all particles, and differ between instants."""
    operations = [x(0)]
    for k in range(size):
        operations += [Operation("constant", (), k), Operation("add", (2 * k, 2 * k + 1))]
    return program(operations, constants=np.random.default_rng(1).normal(size=(2, size)))


def every(size):
    """All operations of two numbers or one in turn; all their values are needed at the end."""
    names = [name for name in TAKES if TAKES[name] in ("f", "ff") and name != "covariate"]
    operations = [x(k) for k in range(20)]
    for k in range(size):
        name, taken = names[k % len(names)], (k % 20, (7 * k + 3) % 20)
        operations.append(Operation(name, taken[: len(TAKES[name])], 0 if name == "take" else None))
    values = []
    for k in range(20, 20 + size):
        values.append(k if operations[k].name not in MASKS else len(operations))
        operations += [Operation("float", (k,))] if operations[k].name in MASKS else []
    total = values[0]
    for each in values[1:]:
        operations.append(Operation("add", (total, each)))
        total = len(operations) - 1
    return program(operations)


CASES = [
    (long_step, 900), slow(chain, 1300), slow(shared, 480),
    slow(entries, 560), slow(states, 540), slow(every, 60),
]  # fmt: skip
LIMITS = [
    (chain, MOST_OPERATIONS - 2), (long_step, MOST_IN_STEP - 2), (entries, 9_900), (states, 4_900),
    (shared, 20_000), (every, 200), (every, 2_000),
]  # fmt: skip


def frames(text):
    """The bytes of the stack that each function takes, from its assembly; infinite if it varies."""
    found, name = {"": 0.0}, ""
    for line in text.splitlines():
        if label := re.match(r"_?(\w+):", line):
            name = label[1]
        # sub $24, %rsp (x86); sub sp, sp, #16 or sub x9, sp, #9, lsl #12; sub x9, x9, #8 (aarch64)
        taken = re.match(r"\s+subq?\s+(?:\$?(\S+), %rsp|(?:sp|x9), sp, (.*)|x9, x9, (#.*))", line)
        if taken:  # x9 may hold anything else, too
            size = re.match(r"#?(\d+)(?:, lsl #(\d+))?$", taken[taken.lastindex].strip())
            bytes_taken = int(size[1]) << int(size[2] or 0) if size else float("inf")
            found[name] = found.get(name, 0.0) + bytes_taken
    return found


@pytest.mark.parametrize("processor", ["haswell", *map(slow, [*PROCESSORS][1:])])
@pytest.mark.parametrize(("write", "size"), [*CASES, *(slow(*each) for each in LIMITS)])
def test_no_frame_exceeds_64_kb(write, size, processor):
    """A value takes 128 bytes, so 520 values would fill such a frame."""
    halves = [each for each in split(write(size), LAYOUT)[::2] if each.outputs]
    assert "alloca" not in str(module_of((*halves,))[0])
    most = max(frames(assembly(halves, PROCESSORS[processor], processor)).values())
    assert most <= MOST


def test_the_frames_of_a_function_are_read_from_its_assembly():
    text = (
        "one:\n\tpushq %rbp\n\tsubq\t$679040, %rsp\n.LBB0:\n\tsubq $1, %rax\n"
        "two:\n\tsub\tx9, sp, #9, lsl #12\n\tsub\tx9, x9, #2208\n\tand\tsp, x9, #0xff80\n"
        "three:\n\tsubq\t%rax, %rsp\nfour:\n\tsub\tsp, sp, #480\n\tsub x8, x8, #3\n"
    )
    found = frames(text)
    assert found == {"": 0, "one": 679040, "two": 39072, "three": float("inf"), "four": 480}


@pytest.mark.parametrize("write", [long_step, *map(slow, (shared, chain, entries, states))])
def test_a_long_program_has_the_values_of_its_plain_twin_on_a_small_stack(write):
    """All operations are rounded exactly, so the bits are the same. A frame grew to 1 MB here."""
    some = write(600 if write is not chain else 3000)
    instants = range(len(some.constants))
    traced, values = Traced.symbolic(some, instants), np.random.default_rng(4)
    states = np.round(values.normal(size=(600, 1, 32)), 3)
    got = list[object]()

    def compute():
        blocks = compile_blocks([Source(traced, LAYOUT, {}, len(some.outputs))], instants).blocks
        w, y = np.zeros((1, 1, 32), np.float32), np.zeros((1, 1))
        got.append(called(blocks, 0, states, w, y, len(some.outputs)))

    before = threading.stack_size(512 * 1024)
    try:
        thread = threading.Thread(target=compute)
        thread.start()
    finally:
        threading.stack_size(before)
    thread.join()
    (found,) = got
    np.testing.assert_array_equal(found, np.array(traced.values({"x": states}, 0, {})))
