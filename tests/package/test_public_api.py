"""The names that users may rely on."""

from __future__ import annotations

import importlib
import types

import pytest

import matiere as mt

PUBLIC = {
    "AssetChanged", "Bsdf", "BsdfSample", "Cancelled", "Client", "ColourError", "Comparison",
    "Film", "FilmError",
    "ImageError", "JobStatus", "Lobe", "MatiereError",
    "MemoryLimitError", "ProbeError", "RenderError", "Replay", "Scene", "SceneModel",
    "SceneValidationError", "ServiceError", "ServiceEvent", "Signature", "SweepStatus",
    "Unreachable",
    "__version__", "bsdf", "check", "chunks", "compare", "denoise",
    "develop", "errors", "film_key", "info",
    "load", "load_film", "loads", "materials", "metals", "read_image",
    "render", "replay", "schema", "signature", "write_image",
}  # fmt: skip


def test_all_names_the_public_ones() -> None:
    assert set(mt.__all__) == PUBLIC
    assert set(dir(mt)) >= PUBLIC


@pytest.mark.parametrize("name", sorted(PUBLIC))
def test_public_names_have_docs(name: str) -> None:
    value = getattr(mt, name)
    assert name == "__version__" or (value.__doc__ or "").strip()


def test_importing_a_module_does_not_hide_its_function() -> None:
    for name in ("develop", "materials", "render"):
        importlib.import_module(f"matiere.{name}")
        assert not isinstance(getattr(mt, name), types.ModuleType)


def test_unknown_names_are_attribute_errors() -> None:
    with pytest.raises(AttributeError, match="no attribute 'rendr'"):
        mt.rendr  # noqa: B018


def test_errors_have_one_root_code_message_and_pointer() -> None:
    kinds = [
        getattr(mt, n)
        for n in mt.__all__
        if isinstance(getattr(mt, n), type) and issubclass(getattr(mt, n), Exception)
    ]
    assert len(kinds) == 12
    for kind in kinds:
        assert issubclass(kind, mt.MatiereError)
    problem = {"code": "queue_full", "detail": "1 job waits.", "remedy": "Ask again."}
    refused = mt.ServiceError(problem, 429)
    assert (refused.code, refused.status, str(refused)) == (
        "queue_full", 429, "1 job waits. Ask again.",
    )  # fmt: skip
    error = mt.ImageError("cannot", pointer="/output")
    assert (error.code, error.message, error.pointer) == ("image_error", "cannot", "/output")
    assert str(error) == "/output: cannot"


def test_errors_survive_pickling() -> None:
    import pickle

    fault = mt.errors.Fault("/film", "film_too_large", "too large", "smaller")
    for error in (mt.ImageError("x", code="y", pointer="/z"), mt.SceneValidationError([fault])):
        copy = pickle.loads(pickle.dumps(error))
        assert type(copy) is type(error)
        assert (copy.code, copy.message, copy.pointer) == (
            error.code, error.message, error.pointer,
        )  # fmt: skip
    assert copy.errors == [fault.as_dict()]
    refused = pickle.loads(pickle.dumps(mt.ServiceError({"code": "gone", "detail": "Why."}, 404)))
    assert (refused.code, refused.status, refused.message) == ("gone", 404, "Why.")
