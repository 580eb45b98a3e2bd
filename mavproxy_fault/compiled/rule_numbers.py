"""The numbers by which compiled code calls the rules of the built-in faults."""

from functools import cache

from mavproxy_fault.fault_parts.rules import LINK_RULES, VALUE_RULES, Rule
from mavproxy_fault.faults.registry import our_faults


def _name(rule: Rule) -> str:
    return f"{rule.__module__}.{rule.__name__}"


@cache
def value_rules() -> tuple[Rule, ...]:
    """All rules of values in the order of their names, whatever was imported first."""
    our_faults()
    return tuple(sorted(VALUE_RULES, key=_name))


@cache
def link_rules() -> tuple[Rule, ...]:
    """All rules of links."""
    our_faults()
    return tuple(sorted(LINK_RULES, key=_name))
