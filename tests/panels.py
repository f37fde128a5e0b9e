"""Virtual panels whose header says how well their constants are known."""

from dataclasses import replace


def panel_stated(run, share, **constants):
    """Return the run with density, conductivity and heat capacity in its header, each known to a share of itself.

    By default the nominal constants of the virtual press; a truth's own where they are given by name.
    """
    given = {"density_kg_m3": run.header["panel.density_kg_m3"], "conductivity_W_mK": 0.12}
    given |= {"heat_capacity_J_kgK": 1550.0} | constants
    header = {f"panel.{key}": value for key, value in given.items()}
    header |= {f"panel.{key}.sd": share * value for key, value in given.items()}
    return replace(run, header={**run.header, **header})
