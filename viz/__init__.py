"""Records and arrays made visible: recordings, figures, the report."""

from typing import TYPE_CHECKING

from registry import lazily

if TYPE_CHECKING:
    from viz.diagnosis import diagnosis_figure as diagnosis_figure
    from viz.figures import drift_figure as drift_figure
    from viz.figures import force_figure as force_figure
    from viz.figures import ladder_figure as ladder_figure
    from viz.figures import save_png as save_png
    from viz.figures import save_svg as save_svg
    from viz.margins import margin_figure as margin_figure
    from viz.overlay import contact_sheet as contact_sheet
    from viz.recording import write_overlay_recording as write_overlay_recording
    from viz.recording import write_recording as write_recording
    from viz.report import write_report as write_report
    from viz.results import write_results as write_results
    from viz.showcase import read_showcase as read_showcase
    from viz.stress import write_stress_report as write_stress_report
    from viz.sweeps import sweep_figure as sweep_figure
    from viz.trade import write_trade as write_trade

HOMES = {
    "contact_sheet": "viz.overlay",
    "diagnosis_figure": "viz.diagnosis",
    "drift_figure": "viz.figures",
    "force_figure": "viz.figures",
    "ladder_figure": "viz.figures",
    "margin_figure": "viz.margins",
    "read_showcase": "viz.showcase",
    "save_png": "viz.figures",
    "save_svg": "viz.figures",
    "sweep_figure": "viz.sweeps",
    "write_overlay_recording": "viz.recording",
    "write_recording": "viz.recording",
    "write_report": "viz.report",
    "write_results": "viz.results",
    "write_stress_report": "viz.stress",
    "write_trade": "viz.trade",
}
__all__ = list(HOMES)
__getattr__, __dir__ = lazily(__name__, HOMES)
