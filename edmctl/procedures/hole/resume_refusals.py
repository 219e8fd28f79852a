"""Refusals of a job whose work, place or tool are not those that were left. Nothing was sparked by then."""

from __future__ import annotations

from typing import TYPE_CHECKING

from edmctl.errors import PreconditionError
from edmctl.process.next_cut import COVERAGE
from edmctl.wording import coordinates, with_u95

if TYPE_CHECKING:
    from edmctl.procedures.hole.expected_touches import Estimate
    from edmctl.procedures.job import Site
    from edmctl.process.wear import DepthAndWear


def other_work(site: Site, found: DepthAndWear, expected: Estimate, *, begun: bool) -> PreconditionError:
    """E8060: the touches found no hole of that depth."""
    if begun:
        otherwise = "On untouched work, --restart-hole makes the hole from its face."
    else:
        otherwise = "For new work, order the places that are left as a job of their own."
    return PreconditionError(
        f"{site.name} at {coordinates(site.x_um, site.y_um)} is "
        f"{with_u95(found.depth_um, found.depth_u95_um)} µm deep; the journal expects "
        f"{with_u95(expected.depth_um, COVERAGE * expected.depth_u_um)} µm.",
        hint=f"Other work, or other places: put the work back as it was, and home the stages. {otherwise}",
        code="E8060",
    )


def other_tool(found: DepthAndWear, expected: Estimate) -> PreconditionError:
    """E8061: the hole is that deep, but the tool is not as long as it was left."""
    return PreconditionError(
        f"The tool is {with_u95(found.wear_um, found.wear_u95_um)} µm shorter than before the hole; the journal "
        f"expects {with_u95(expected.wear_um, COVERAGE * expected.wear_u_um)} µm.",
        hint="It was changed or seated anew, and only the tool that began a hole can tell its own wear by touching. "
        "Machine another hole, at another place.",
        code="E8061",
    )


def touched_face(site: Site, found: DepthAndWear) -> PreconditionError:
    """E8062: there is a hole where one is to be begun."""
    return PreconditionError(
        f"There is no untouched face at {site.name}: it is {with_u95(found.depth_um, found.depth_u95_um)} µm deep.",
        hint="Go on with the hole without --restart-hole, or put untouched work in.",
        code="E8062",
    )
