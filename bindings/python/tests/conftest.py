"""What tests share: the files of the repository, and answers to compare."""

from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[3]
FOREIGN = ROOT / "tests" / "golden" / "onnx-foreign"
OPTIONS = {"torch_mha_own_query.classic": {"sizes": {"N": 7}}}


def foreign(name):
    return FOREIGN / f"{name}.onnx"


def recorded(name):
    with np.load(FOREIGN / f"{name}.npz") as arrays:
        return dict(arrays)


def assert_close(got, want):
    """|a - b| <= 1e-5 (1 + |b|)."""
    got, want = np.asarray(got, "f8"), np.asarray(want, "f8")
    assert got.shape == want.shape
    assert (np.abs(got - want) <= 1e-5 * (1 + np.abs(want))).all()


@pytest.fixture
def root():
    return ROOT
