"""Schemas of the nodes' parameter files: observer, controller, live rig and identify."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import replace

from ces_cli.discovery.schemas.parts import FLAG, TEXT, Schema, list_of, mapping_of, of_parameters, with_description
from ces_cli.discovery.schemas.signal_files import dotted_signals, parameter_file, signal_properties
from ces_cli.identify.options import EXIT_WHEN_DONE, PARAMETERS
from ces_observer.nodes import controller_table
from ces_observer.nodes.observer_table import DAMPERS, DAMPERS_MEANING, NAME, OF_A_DAMPER, OF_THE_NODE
from ces_observer.nodes.parameter_table import OF_ROS, ParameterSpec
from ces_rig.live import node_table

ROS: dict[str, Schema] = {
    "use_sim_time": with_description(FLAG, "take time from /clock"),
    "start_type_description_service": FLAG,
    "qos_overrides": with_description({"type": "object"}, "quality of service by resolved topic name"),
}
ROS_DOTTED: dict[str, Schema] = {rf"^({'|'.join(OF_ROS)})\.": {}}


def observer_schema() -> Schema:
    """Return the schema of the observer's parameters: of the node, of each damper, and of its signals."""
    of_a_damper = {**of_parameters((*OF_A_DAMPER, NAME)), **signal_properties()}
    own = {**of_parameters(OF_THE_NODE), **of_a_damper, DAMPERS: with_description(list_of(TEXT), DAMPERS_MEANING)}
    damper = {**mapping_of(of_a_damper), "patternProperties": dotted_signals()}
    return parameter_file({**own, **ROS}, {**dotted_signals(), **ROS_DOTTED}, damper)


def controller_schema() -> Schema:
    """Return the schema of the controller's parameters."""
    return parameter_file({**of_parameters(controller_table.ALL), **ROS}, ROS_DOTTED, False)


def rig_node_schema() -> Schema:
    """Return the schema of the live rig's parameters."""
    table = (*node_table.OF_THE_NODE, *node_table.OF_THE_RIG)
    return parameter_file({**of_parameters(table), **ROS}, _list_dotted(table) | ROS_DOTTED, False)


def identify_node_schema() -> Schema:
    """Return the schema of the parameters of the node identify."""
    return parameter_file({**of_parameters((*PARAMETERS, EXIT_WHEN_DONE)), **ROS}, ROS_DOTTED, False)


def _list_dotted(table: Iterable[ParameterSpec]) -> dict[str, Schema]:
    """Return patterns of names with dots, which ROS 2 reads as the nested form."""
    last = {spec.name: replace(spec, name=spec.name.rpartition(".")[2]) for spec in table if "." in spec.name}
    return {rf"^{re.escape(name)}$": of_parameters([spec])[spec.name] for name, spec in last.items()}
