// One entry for each sentence of an effect's confirming measurement (softsensor/effects), in German.
const MEASUREMENTS = {
  "Touch a platen and a panel thermocouple at once with a soldering iron and compare": "Berühren Sie einen Heizplatten- und einen Plattenfühler gleichzeitig mit einem Lötkolben und vergleichen Sie",
  "Measure k of this board, or press panels of different thickness": "Messen Sie die Wärmeleitfähigkeit dieser Platte, oder pressen Sie verschiedene Dicken",
  "Measure k at 25 and 100 °C (guarded hot plate), or press a panel with a core thermocouple": "Messen Sie die Wärmeleitfähigkeit bei 25 und 100 °C, oder pressen Sie eine Platte mit Kernfühler",
  "Turn the panel over, or exchange the press plates": "Drehen Sie die Platte um, oder tauschen Sie die Pressbleche",
  "Repeat with bare panels and with twice the closing speed; log pressure": "Wiederholen Sie mit unbeschichteten Platten und doppelter Schließgeschwindigkeit; zeichnen Sie den Druck auf",
  "Press the same kind of panel at three pressures": "Pressen Sie gleiche Platten mit drei Drücken",
  "Measure the density profile (X-ray), or press a panel with a core thermocouple": "Messen Sie das Dichteprofil (Röntgen), oder pressen Sie eine Platte mit Kernfühler",
  "Insulate the rim, or compare sensors at the rim with sensors in the middle": "Dämmen Sie den Rand, oder vergleichen Sie Fühler am Rand mit solchen in der Mitte",
  "Weigh and measure the panel; measure its heat capacity; press panels of different thickness": "Wiegen und vermessen Sie die Platte; messen Sie ihre Wärmekapazität; pressen Sie verschiedene Dicken",
  "Measure c at 20 to 100 °C (DSC), or press a panel with a core thermocouple": "Messen Sie die Wärmekapazität von 20 bis 100 °C (DSC), oder pressen Sie eine Platte mit Kernfühler",
  "Wait two minutes between pressings, or tape a thermocouple to a press plate": "Warten Sie zwei Minuten zwischen Pressungen, oder kleben Sie einen Fühler auf ein Pressblech",
  "Weigh the panel before and after pressing, or press one dried to zero moisture": "Wiegen Sie die Platte vor und nach dem Pressen, oder pressen Sie eine darrtrockene",
  "Hold a sheet of aluminium foil between panel and upper plate before closing": "Halten Sie vor dem Schließen Aluminiumfolie zwischen Platte und oberes Blech",
  "Press the same board bare": "Pressen Sie dieselbe Platte unbeschichtet",
  "Compare the platen thermocouples with a calibrated one at working temperature": "Vergleichen Sie die Heizplattenfühler bei Betriebstemperatur mit einem kalibrierten",
  "Press the same panel a second time: cured resin gives no more heat": "Pressen Sie dieselbe Platte ein zweites Mal: ausgehärtetes Harz gibt keine Wärme mehr ab",
  "Check the named thermocouples: fixing, polarity, plug position": "Prüfen Sie die genannten Fühler: Befestigung, Polung, Steckplatz",
  "Use thinner wire, or put one thermocouple under a sheet of foil": "Nehmen Sie dünneren Draht, oder legen Sie einen Fühler unter Folie",
  "Dip one thermocouple into hot water and log its step response": "Tauchen Sie einen Fühler in heißes Wasser und zeichnen Sie die Sprungantwort auf",
  "Press one sacrificial panel with a thermocouple in its middle": "Pressen Sie eine Opferplatte mit Fühler in der Mitte",
  "Two or three sacrificial panels with a core thermocouple would settle the core temperature": "Zwei oder drei Opferplatten mit Kernfühler würden die Kerntemperatur klären",
};
const LOWER = Object.fromEntries(Object.entries(MEASUREMENTS).map(([english, german]) => [english.toLowerCase(), german]));

export const measurement = (english) => LOWER[english.toLowerCase()];

// A text that ends in a measurement: what stands before it, and the measurement in German.
export function endingInMeasurement(english) {
  const end = Object.keys(LOWER).find((known) => english.toLowerCase().endsWith(known));
  return end ? [english.slice(0, -end.length).replace(/[.;] $/, ""), LOWER[end]] : [english, ""];
}
