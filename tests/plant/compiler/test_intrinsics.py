"""Texts of one kernel: each means by its names what it meant when it stood alone."""

import inspect
import re

import pytest

from plant.compiler import MODULES, head, joined, llvm

CONSTANT = "import math\n\nSTEP = 0.1\n\n\ndef half():\n    return STEP / 2\n"


def names(text):
    namespace = {}
    exec(joined(*text), namespace)  # noqa: S102 - texts of this file
    return namespace


def test_texts_that_share_imports_alone_are_one_module():
    made = names([CONSTANT, "import math\n\nOTHER = math.pi\n"])
    assert (made["half"](), made["OTHER"]) == (0.05, made["math"].pi)


@pytest.mark.parametrize(
    "other",
    [
        "STEP = 3\n",
        "A, (B, *STEP) = 1, (2, 3)\n",
        "def STEP(x):\n    return x\n",
        "class STEP:\n    pass\n",
        "if True:\n    STEP = 3\n",
        "for STEP in range(3):\n    pass\n",
        "STEP: int = 3\n",
        "from os import path as STEP\n",
        "import cmath as math\n",
        "math = None\n",
        "def half_{h}():\n    pass\n\n\nhalf = half_{h}\n",
    ],
)
def test_a_name_that_would_change_its_meaning_is_refused(other):
    """In whatever order: silently, `half` would be another function or use another step."""
    for texts in ([CONSTANT, other], [other, CONSTANT]):
        with pytest.raises(
            ValueError, match=r"must bind a name once; two bind (STEP|math|half)\. Rename"
        ):
            joined(*texts)


@pytest.mark.parametrize("name", ["WHOLE", "Emitter", "LONG", "intrinsic", "compiled"])
def test_no_text_behind_the_head_of_a_kernel_may_use_its_names(name):
    assert re.search(rf"\b{name}\b", inspect.getsource(llvm) + MODULES)
    with pytest.raises(ValueError, match=rf"bind {name}\."):
        joined(head(), f"{name} = 1\n")
