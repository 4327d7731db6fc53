"""The recording and the model that the tests of the door share."""

from __future__ import annotations

from pathlib import Path

import pytest

import ces

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def road():
    return ces.Recording.load(ROOT / "bags/road")


@pytest.fixture(scope="module")
def model():
    return ces.Model.load(ROOT / "config/models/sample.json")
