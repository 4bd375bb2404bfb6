"""``report.html``: one file that explains a run to someone who has never seen the tool; it needs no network and no scripts."""

from __future__ import annotations

from collections.abc import Callable
from importlib.resources import files

from ebamcheck.atomic_file import replacing
from ebamcheck.errors import EbamcheckError
from ebamcheck.record.run_folder import RunFolder
from ebamcheck_reports.markup import Markup, element, header, mark, page, paragraph, section
from ebamcheck_reports.run_data import RunData
from ebamcheck_reports.sections import agreement, evidence, fit, input, metal, program, scan, summary

NAME = "report.html"

SECTIONS: tuple[tuple[str, str, Callable[[RunData], Markup]], ...] = (
    ("summary", "Summary", summary.summary),
    ("verdict", "Verdict", summary.verdict),
    ("part", "Part", input.part),
    ("slicers", "Slicers", input.slicers),
    ("agreement", "Agreement", agreement.render),
    ("fit", "Fit", fit.render),
    ("scan", "Partition and order", scan.render),
    ("metal", "Metal", metal.render),
    ("program", "Program", program.render),
    ("certificate", "Certificate", evidence.certificate),
    ("reproduce", "Reproduce", evidence.reproduce),
)

# Gates that judge what a section shows. The section is folded where they passed; one that is judged by none, where all did.
JUDGED_BY = {
    "part": ("input",),
    "slicers": ("agreement",),
    "agreement": ("agreement",),
    "fit": ("fit",),
    "scan": ("coverage", "heat"),
    "metal": ("deposit",),
    "program": ("program", "entry"),
}

# Sections that are left out for a cross-check alone
OF_THE_PROGRAM = ("fit", "scan", "metal", "program", "certificate")


def write(run: RunFolder) -> list[str]:
    """Write the report into the run folder and return its name."""
    text = document(RunData(run))
    with replacing(run.path / NAME) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return [NAME]


def document(run: RunData) -> str:
    """Build the whole page."""
    record, program = run.part_of("part"), run.manifest.get("program")
    made = "; no program was made from them."
    if program is not None:
        made = ", and the program made from them was read back and checked."
    head = header(
        f"Slicing report: {record['name']}",
        f"{record['source']}, checked by ebamcheck {run.manifest['ebamcheck']}. "
        f"The part was cut by several methods and the results were compared{'.' if run.is_check else made}",
        [chapter[:2] for chapter in _chapters(run)],
    )
    said = paragraph("Every figure is from ", element("code", "run.json"), " in the folder of this report.")
    script = files("ebamcheck_reports").joinpath("report.js").read_text(encoding="utf-8")
    return page(
        f"ebamcheck: {record['name']}",
        head,
        element("main", *_sections(run)),
        element("footer", said),
        element("script", Markup(f"//<![CDATA[\n{script}//]]>")),
    )


def _chapters(run: RunData) -> list[tuple[str, str, Callable[[RunData], Markup]]]:
    """Sections that apply to the job."""
    return [chapter for chapter in SECTIONS if not (run.is_check and chapter[0] in OF_THE_PROGRAM)]


def _sections(run: RunData) -> list[Markup]:
    made = []
    for anchor, title, render in _chapters(run):
        try:
            made.append(_folded(run, anchor, title, render(run)))
        except EbamcheckError as error:
            # A missing or damaged file of the run costs its section, not the whole report.
            said = paragraph(str(error), class_="note bad")
            made.append(section(anchor, title, "This section cannot be shown.", said))
    return made


def _folded(run: RunData, anchor: str, title: str, rendered: Markup) -> Markup:
    """The summary as it is; a section after it under its title, open where something did not pass."""
    if anchor == "summary":
        return rendered
    shut = {str(gate["name"]) for gate in run.gates if not gate["passed"]} | set(run.missing_gates)
    passed = not shut.intersection(JUDGED_BY[anchor]) if anchor in JUDGED_BY else run.passed
    head = element("summary", element("b", title), " ", mark(True) if passed and anchor in JUDGED_BY else "")
    return element("details", head, rendered, class_="chapter", open=None if passed else "open")
