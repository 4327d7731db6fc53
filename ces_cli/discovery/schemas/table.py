"""All schemas by name, with what each is for."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping

from ces_cli.discovery.schemas.candidate_files import candidates_schema
from ces_cli.discovery.schemas.node_files import (
    controller_schema,
    identify_node_schema,
    observer_schema,
    rig_node_schema,
)
from ces_cli.discovery.schemas.parts import Schema
from ces_cli.discovery.schemas.plan_files import campaign_schema, iterate_schema, learn_stroke_schema
from ces_cli.discovery.schemas.rig_files import damper_schema, experiment_schema
from ces_cli.discovery.schemas.signal_files import import_schema, signals_schema
from ces_identify.schema_files import ABOUT

DRAFT = "http://json-schema.org/draft-07/schema#"


BUILDERS: Mapping[str, Callable[[], Schema]] = {
    "signals": signals_schema,
    "import": import_schema,
    "candidates": candidates_schema,
    "campaign": campaign_schema,
    "experiment": experiment_schema,
    "damper": damper_schema,
    "iterate": iterate_schema,
    "learn-stroke": learn_stroke_schema,
    "observer": observer_schema,
    "controller": controller_schema,
    "rig-node": rig_node_schema,
    "identify-node": identify_node_schema,
}


def build_schema(name: str) -> str:
    """Return the text of a schema's file."""
    head = {"$schema": DRAFT, "title": ABOUT[name]}
    return json.dumps({**head, **BUILDERS[name]()}, indent=1, ensure_ascii=False) + "\n"
