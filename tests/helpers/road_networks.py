"""Road files for tests, made of straight roads and arcs."""

from __future__ import annotations

from pathlib import Path

from cornercase.roads._network import RoadNetwork

WIDTH = '<width sOffset="0" a="4" b="0" c="0" d="0"/>'


def lane(number: int, before: int | None = None, after: int | None = None, inside: str = WIDTH, more: str = "") -> str:
    """A driving lane, linked to the lanes before and after it."""
    links = "".join(
        f'<{name} id="{other}"/>'
        for name, other in (("predecessor", before), ("successor", after))
        if other is not None
    )
    return f'<lane id="{number}" type="driving" {more}><link>{links}</link>{inside}</lane>'


def linked(name: str, to: str, contact: str = "") -> str:
    """A predecessor or successor of a road: `to` a road, or a junction where there is no contact point."""
    kind = f'elementType="road" contactPoint="{contact}"' if contact else 'elementType="junction"'
    return f'<{name} elementId="{to}" {kind}/>'


def road(
    name: str,
    length: float,
    *,
    at: tuple[float, float, float] = (0.0, 0.0, 0.0),
    links: str = "",
    junction: str = "-1",
    shape: str = "<line/>",
    right: str = "",
    left: str = "",
    sections: str = "",
) -> str:
    """A road of one piece; without lanes of its own it has lane -1, linked to lane -1 at both ends."""
    x, y, heading = at
    sections = sections or (
        f'<laneSection s="0"><left>{left}</left><center><lane id="0" type="none"/></center>'
        f"<right>{right or lane(-1, -1, -1)}</right></laneSection>"
    )
    return (
        f'<road id="{name}" length="{length}" junction="{junction}"><link>{links}</link><planView>'
        f'<geometry s="0" x="{x}" y="{y}" hdg="{heading}" length="{length}">{shape}</geometry></planView>'
        f"<lanes>{sections}</lanes></road>"
    )


def write(folder: Path, *parts: str) -> Path:
    """A road file of these roads and junctions."""
    path = folder / "road.xodr"
    path.write_text(f'<OpenDRIVE><header revMajor="1" revMinor="8"/>{"".join(parts)}</OpenDRIVE>')
    return path


def network(folder: Path, *parts: str) -> RoadNetwork:
    """The network of these roads and junctions."""
    return RoadNetwork.read(write(folder, *parts))


def chain(count: int, length: float) -> list[str]:
    """Straight roads that follow each other along x."""
    return [
        road(
            str(k),
            length,
            at=(k * length, 0.0, 0.0),
            links=(linked("predecessor", str(k - 1), "end") if k else "")
            + (linked("successor", str(k + 1), "start") if k + 1 < count else ""),
        )
        for k in range(count)
    ]


def virtual(length: float = 100.0) -> list[str]:
    """A road along x, and one that leaves it at 20 m and comes back at 60 m."""
    aside = (
        '<predecessor elementType="road" elementId="main" elementS="20" elementDir="+"/>'
        '<successor elementType="road" elementId="main" elementS="60" elementDir="+"/>'
    )
    return [
        road("main", length),
        road("aside", 40.0, at=(20.0, -1.0, 0.0), links=aside, junction="v"),
        '<junction id="v" type="virtual" mainRoad="main" sStart="15" sEnd="65" orientation="+">'
        '<connection id="0" incomingRoad="main" connectingRoad="aside" contactPoint="start"/></junction>',
    ]
