import time

from mavproxy_fault.documents.suggestion import suggest_known


def test_a_very_long_name_is_compared_quickly() -> None:
    begun_s = time.process_time()
    assert suggest_known("bias" + "x" * 3_000_000, [f"bias-{n}" for n in range(100)]).startswith(
        "known: "
    )
    assert time.process_time() - begun_s < 0.5


def test_without_known_names_there_is_no_suggestion() -> None:
    assert suggest_known("bias", []) == "none exist"
