import time

from mavproxy_fault.documents.suggestion import suggest_known


def test_a_name_of_megabytes_is_answered_at_once() -> None:
    begun_s = time.process_time()
    assert suggest_known("bias" + "x" * 3_000_000, [f"bias-{n}" for n in range(100)]).startswith(
        "known: "
    )
    assert time.process_time() - begun_s < 0.5


def test_without_names_there_is_nothing_to_mean() -> None:
    assert suggest_known("bias", []) == "none exist"
