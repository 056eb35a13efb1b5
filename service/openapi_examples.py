"""Examples of the OpenAPI document: every body that is sent, every name in an address.

A test holds each against its schema and lets the queue check each submission.
"""

from __future__ import annotations

from typing import Any

JOB, SWEEP = "01a20959-811a-7e8f-9521-5745c324a1c4", "01a2097f-9393-7ac9-bccd-9b823785c234"
DIGEST = "9f86d081884c7d659a2feaa0c55ad015a3bf4f1b2b0b822cd15d6c15b0f00a08"  # of "test"

#: One scene with light, a floor and a ball: what the other examples vary.
SCENE: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "pinhole", "origin": [0, 1.6, 5], "target": [0, 0.85, 0], "vfov_deg": 32},
    "film": {"width": 64, "height": 48},
    "render": {"spp": 16, "seed": 0},
    "materials": {
        "ball": {"type": "conductor", "metal": "Au", "alpha": 0.1},
        "floor": {"type": "lambert", "albedo": [0.35, 0.36, 0.38]},
    },
    "shapes": [
        {"type": "sphere", "center": [0, 1, 0], "radius": 1, "material": "ball"},
        {
            "type": "mesh",
            "positions": [[-9, 0, -9], [9, 0, -9], [9, 0, 9], [-9, 0, 9]],
            "triangles": [[0, 2, 1], [0, 3, 2]],
            "material": "floor",
        },
    ],
    "lights": [
        {
            "type": "rectangle",
            "corner": [-3.5, 4.8, 0.5],
            "edge_u": [2.5, 0, 0],
            "edge_v": [0, -0.8, 2.2],
            "radiance": [17, 16, 14.5],
        }
    ],
    "environment": {"radiance": [0.6, 0.63, 0.7]},
}
SMALLEST: dict[str, Any] = {
    "version": 1,
    "camera": {"type": "pinhole", "origin": [0, 0, 4], "target": [0, 0, 0], "vfov_deg": 40},
    "materials": {"ball": {"type": "plastic", "albedo": [0.5, 0.05, 0.04]}},
    "shapes": [{"type": "sphere", "center": [0, 0, 0], "radius": 1, "material": "ball"}],
    "environment": {"radiance": [1, 1, 1]},
}


def _example(summary: str, value: Any) -> dict[str, Any]:
    return {"summary": summary, "value": value}


_PRIORITY = {"first": _example("run it before most others", {"priority": 80})}

#: "METHOD path" -> name -> example of a body
BODIES: dict[str, dict[str, Any]] = {
    "POST /v1/webhooks": {
        "ends": _example(
            "tell of finished sweeps and failed jobs",
            {"url": "https://example.org/matiere", "kinds": ["sweep_finished", "failed"]},
        )
    },
    "POST /v1/keys": {
        "ci": _example(
            "a key that submits, for 90 days", {"name": "ci", "scope": "submit", "days": 90}
        )
    },
    "POST /v1/keys/{key_id}:rotate": {
        "overlap": _example("the old key goes on for two days", {"days": 90, "overlap_hours": 48})
    },
    "POST /v1/jobs": {
        "smallest": _example("a red ball, everything else by default", {"scene": SMALLEST}),
        "ball": _example(
            "a gold ball, until the error or the samples are reached",
            {
                "scene": SCENE,
                "stop": {"spp": 64, "target_error": {"relmse": 0.001}},
                "priority": 60,
                "label": "gold, rough",
            },
        ),
        "deadline": _example(
            "what there is after an hour at the latest",
            {"scene": SCENE, "stop": {"spp": 4096}, "deadline": 3600, "cache": "use"},
        ),
    },
    "POST /v1/sweeps": {
        "grid": _example(
            "four roughnesses of three metals: twelve jobs",
            {
                "base": SCENE,
                "axes": [
                    {
                        "pointer": "/materials/ball/alpha",
                        "logspace": [0.02, 0.5, 4],
                        "label": "alpha",
                    },
                    {"pointer": "/materials/ball/metal", "values": ["Au", "Cu", "Ag"]},
                ],
                "columns": 3,
                "stop": {"spp": 16},
            },
        ),
        "sobol": _example(
            "eight points that fill an interval evenly",
            {
                "base": SCENE,
                "axes": [{"pointer": "/materials/ball/alpha", "uniform": [0.05, 0.6]}],
                "mode": "sobol",
                "sobol": {"count": 8, "seed": 1},
                "stop": {"spp": 4},
            },
        ),
        "list": _example(
            "cell by cell",
            {
                "base": SCENE,
                "mode": "list",
                "list": [{"/materials/ball/metal": "Au"}, {"/materials/ball/metal": "Ag"}],
                "label": "two metals",
            },
        ),
    },
    "PATCH /v1/jobs/{job_id}": _PRIORITY,
    "PATCH /v1/sweeps/{sweep_id}": _PRIORITY,
    "POST /v1/checks": {
        "glass": _example(
            "is this glass stable?",
            {"material": {"type": "dielectric", "eta": 1.5, "alpha": 0.05}},
        ),
        "gold": _example(
            "with plots",
            {"material": {"type": "conductor", "metal": "Au", "alpha": 0.001}, "plots": True},
        ),
    },
    "POST /v1/compare": {
        "nights": _example("the earlier sweep first", {"a": JOB, "b": SWEEP}),
        "many": _example(
            "an expected share of false alarms",
            {"a": JOB, "b": SWEEP, "significance": 0.01, "method": "bh", "listed": 20},
        ),
    },
    "POST /v1/assets:missing": {
        "two": _example("which of these are to be uploaded?", {"sha256": [DIGEST, "0" * 64]}),
    },
    "PUT /v1/assets/{sha256}": {"bytes": _example("the bytes of the file", "test")},
}

#: name of a parameter -> example
PARAMETERS: dict[str, Any] = {
    "against": JOB,
    "material": '{"type": "conductor", "metal": "Cu", "alpha": 0.2}',
    "job_id": JOB,
    "sweep_id": SWEEP,
    "key_id": "3f9a0c12",
    "webhook_id": "01a209f3-4f0e-7c11-8a55-0b1c5f1f7a3e",
    "cell": 3,
    "sha256": DIGEST,
    "page": 0,
    "Idempotency-Key": "ball-1",
    "Content-Range": "bytes 0-3/4",
    "Last-Event-ID": "17",
    "limit": 20,
    "state": "succeeded",
}

#: name of a schema -> examples of it
SCHEMAS: dict[str, list[Any]] = {
    "JobSubmission": [{"scene": SMALLEST}],
    "SweepSubmission": [
        {"base": SMALLEST, "axes": [{"pointer": "/materials/ball/alpha", "values": [0.1, 0.3]}]}
    ],
    "CheckSubmission": [{"material": {"type": "conductor", "metal": "Au", "alpha": 0.1}}],
    "NightComparison": [{"a": JOB, "b": SWEEP}],
    "Change": [{"priority": 80}],
    "Scene": [SMALLEST],
    "Stop": [{"spp": 256, "seconds": 60}, {"target_error": {"rmse_percent": 1}}],
    "Target": [{"relmse": 0.001}, {"display": {"code_values": 1, "pixels_percent": 95}}],
    "Axis": [
        {"pointer": "/materials/ball/alpha", "linspace": [0.1, 0.5, 5]},
        {"pointer": "/materials/ball/metal", "values": ["Au", "Cu"], "label": "metal"},
        {"pointer": "/materials/ball/alpha", "loguniform": [0.01, 0.5]},
    ],
    "SobolPoints": [{"count": 64, "seed": 1}],
    "Override": [{"when": "metal == 'Au'", "set": {"/render/spp": 64}}],
}
