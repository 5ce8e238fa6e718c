"""What the short form with its fixed seed must not fall behind."""

from typing import Any

Json = dict[str, Any]


def missed(records: list[Json]) -> list[str]:
    """Bounds that the records do not keep, in words; none: all is as it was."""
    judged = [record for record in records if "verdict" in record]
    healthy = [r for r in judged if r["stratum"] in ("noise", "parametric", "invisible")]
    single = [r for r in judged if r["stratum"] == "single" and r["enr"] >= 1]
    faults = [r for r in judged if r["stratum"] == "broken"]
    unknown = [r for r in judged if r["stratum"] == "unknown" and r["enr"] >= 1]
    bounds = [
        ("structure claimed on sound joints", sum(r["verdict"] != "none" for r in healthy), 0),
        ("confident wrong names", sum(r["confident_wrong"] for r in judged), 1),
        ("effects told at ENR >= 1, missed", sum(not r["right_class"] for r in single), 0),
        ("unknowns misnamed", sum(r["misnamed"] for r in unknown), 0),
        ("data faults not named", sum(not r["fault_named"] for r in faults), 0),
    ]
    return [f"{name}: at most {most}, got {count}" for name, count, most in bounds if count > most]
