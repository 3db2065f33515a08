"""All tables by name; a new one is one line."""

from __future__ import annotations

from registry import Registry
from vidphys.experiments.confusion import table as diagnose
from vidphys.experiments.confusion.storms import table as storms
from vidphys.experiments.contacts import table as contacts
from vidphys.experiments.core.cell import Table
from vidphys.experiments.coupling import misspecification, selection
from vidphys.experiments.filmed import table as filmed
from vidphys.experiments.formulas import table as formulas
from vidphys.experiments.friction import drag, engine
from vidphys.experiments.gravity import families, planning, scale, sparse, sweeps, transport
from vidphys.experiments.gravity import table as gravity
from vidphys.experiments.heat import drive, thermostat
from vidphys.experiments.ladder import LADDER
from vidphys.experiments.linear import factorial, maps, necessity, removal
from vidphys.experiments.pixels import (
    consistency,
    encoder_scale,
    perception_speed,
    pixel_heads,
    probes,
    readout_controls,
    surprise,
    unfamiliar,
)
from vidphys.experiments.recorded import table as recorded

TABLES: Registry[Table] = Registry("table", "vidphys.tables")
for table in (
    LADDER,
    gravity.STABILITY,
    gravity.INVERSION,
    gravity.DISSOCIATION,
    gravity.GRAPH_NETS,
    gravity.BASELINES,
    gravity.EXTRAPOLATION,
    sweeps.CAPACITY,
    sweeps.DATA,
    sweeps.SENSITIVITY,
    sparse.SPARSE,
    contacts.CONTACTS,
    families.COULOMB,
    families.MIXED,
    necessity.NECESSITY,
    necessity.COMPOSITION,
    removal.REMOVAL,
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
    storms.DIAGNOSE_STORMS,
    filmed.FILMED,
    formulas.FORMULAS,
    recorded.RECORDED,
    probes.PROBES,
    pixel_heads.PIXEL_HEADS,
    perception_speed.PERCEPTION_SPEED,
    readout_controls.OWN_CNN_READOUT,
    readout_controls.POOLED_CONTROL,
    consistency.CONSISTENCY,
    surprise.SURPRISE,
    unfamiliar.UNFAMILIAR,
    encoder_scale.ENCODER_SCALE,
):
    TABLES.register(table.name, table)
