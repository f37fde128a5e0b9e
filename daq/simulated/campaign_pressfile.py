"""The press file of the virtual press, as a laboratory would write it."""

from __future__ import annotations

from daq.simulated.campaign_sensors import POSITIONS_MM
from daq.simulated.physics_pressing import LOAD_REFERENCE, Plates


def press_toml(positions: bool = False, plates: Plates | None = None, loaded: bool = False) -> str:
    """Return the press file of the virtual press.

    Parameters
    ----------
    positions
        Adds the sensors' places over the face.
    plates
        Of another press; steel of 10 mm otherwise.
    loaded
        The panel's contacts follow the column ``load``.
    """
    steel = plates or Plates()
    plate = (
        f"thickness_mm = {steel.thickness * 1000.0:.6g}\nconductivity_W_mK = {steel.conductivity:.6g}\n"
        f"density_kg_m3 = {steel.density:.6g}\nheat_capacity_J_kgK = {steel.heat_capacity:.6g}\n"
    )
    text = '[press]\nname = "lab"\narea_m2 = 0.25\n'
    text += f'\n[[layer]]\nname = "plate_bottom"\n{plate}\n[[layer]]\nname = "panel"\nfrom_run = true\n'
    text += f'\n[[layer]]\nname = "plate_top"\n{plate}'
    for end in ("bottom", "top"):
        text += f'\n[boundary.{end}]\nkind = "measured"\ncolumn = "platen_{end}"\n'
    for pair, opened, closed in (
        ('"boundary.bottom", "plate_bottom"', '"h_p_o"', "h_p_c"),
        ('"plate_bottom", "panel"', '"h_pp_o"', "h_pp_c"),
        ('"panel", "plate_top"', '["h_wa", "h_ap"]', "h_pp_c"),
        ('"plate_top", "boundary.top"', '"h_p_o"', "h_p_c"),
    ):
        text += f'\n[[contact]]\nbetween = [{pair}]\nopen = {opened}\nclosed = "{closed}"\n'
        if loaded and "panel" in pair:
            text += f'load = {{ column = "load", reference = {LOAD_REFERENCE:g}, unit = "N/cm2" }}\n'
    for name, (guess, lower, upper) in _GUESSES.items():
        text += f"\n[coefficients.{name}]\nguess = {guess}\nlower = {lower}\nupper = {upper}\n"
    places = f"position_mm = {[list(p) for p in POSITIONS_MM]}\n" if positions else ""
    for face in ("top", "bottom"):
        text += f'\n[[sensor]]\ncolumns = ["{face}_*"]\nat = "panel.{face}"\n{places}'
    return text + '\n[[sensor]]\ncolumns = ["core_*"]\nat = "panel.middle"\nrole = "validation"\n'


_GUESSES = {
    "h_p_o": (500.0, 10.0, 50000.0),
    "h_p_c": (700.0, 10.0, 50000.0),
    "h_pp_o": (30.0, 1.0, 2000.0),
    "h_pp_c": (700.0, 10.0, 50000.0),
    "h_wa": (12.0, 1.0, 200.0),
    "h_ap": (10.0, 1.0, 200.0),
}
