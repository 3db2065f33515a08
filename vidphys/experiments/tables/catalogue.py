"""All tables by name; a new one is one line."""

from __future__ import annotations

from vidphys.experiments.tables import (
    contacts,
    diagnose,
    drag,
    drive,
    engine,
    factorial,
    families,
    gravity,
    maps,
    misspecification,
    necessity,
    planning,
    probes,
    scale,
    selection,
    sweeps,
    thermostat,
    transport,
)
from vidphys.experiments.tables.base import Table

TABLES: dict[str, Table] = {
    table.name: table
    for table in (
        gravity.STABILITY,
        gravity.INVERSION,
        gravity.DISSOCIATION,
        gravity.GRAPH_NETS,
        gravity.BASELINES,
        gravity.EXTRAPOLATION,
        sweeps.CAPACITY,
        sweeps.DATA,
        sweeps.SENSITIVITY,
        contacts.CONTACTS,
        families.COULOMB,
        families.MIXED,
        necessity.NECESSITY,
        necessity.COMPOSITION,
        scale.N_TRANSFER,
        thermostat.THERMOSTAT,
        thermostat.MEASUREMENT_NOISE,
        drive.DRIVE,
        drive.NO_STEADY_STATE,
        factorial.FACTORIAL,
        factorial.CURL_TABLE,
        maps.MAPS,
        misspecification.MISSPECIFICATION,
        selection.SELECTION,
        transport.TRANSPORT,
        planning.PLANNING,
        planning.NOISE,
        engine.ENGINE,
        engine.FORMALISMS,
        engine.DISSIPATION,
        engine.ANTI_FRICTION,
        engine.REVERSAL,
        drag.DRAG,
        diagnose.DIAGNOSE,
        probes.PROBES,
    )
}
