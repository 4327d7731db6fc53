"""What a running node answers to the cases of `parameter_cases`, by both services."""

from __future__ import annotations

from parameter_cases import CASES
from party import Party
from patience import PATIENCE_S, wait_until
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue, SetParametersResult
from rcl_interfaces.srv import SetParameters, SetParametersAtomically


def as_message(name: str, kind: str, value: object) -> Parameter:
    """Return a parameter of a type that need not exist."""
    number = int(kind) if kind.isdigit() else getattr(ParameterType, f"PARAMETER_{kind.replace(' ', '_').upper()}")
    fields = {} if value is None else {f"{kind}_value": value}
    return Parameter(name=name, value=ParameterValue(type=number, **fields))


def require_answers(party: Party, name: str) -> None:
    """Fail unless the node `name` answers each case as it must, together with the others and alone."""
    parameters, expected = [as_message(*case[:3]) for case in CASES], [case[3] for case in CASES]
    service = party.node.create_client(SetParameters, f"{name}/set_parameters")
    alone = party.node.create_client(SetParametersAtomically, f"{name}/set_parameters_atomically")
    assert service.wait_for_service(PATIENCE_S) and alone.wait_for_service(PATIENCE_S)
    answer = service.call_async(SetParameters.Request(parameters=parameters))
    wait_until(answer.done, f"no answer of {name}")
    assert _words(answer.result().results) == expected
    results = []
    for one in parameters:  # one by one: the client's queue of answers is short
        answer = alone.call_async(SetParametersAtomically.Request(parameters=[one]))
        wait_until(answer.done, f"no answer of {name} to one parameter alone")
        results.append(answer.result().result)
    assert _words(results) == expected


def _words(results: list[SetParametersResult]) -> list[str]:
    assert all(result.successful != bool(result.reason) for result in results)
    return [result.reason for result in results]
