// One line for the screen reader when something happens, not for each scan.
export function announce(message) {
  document.getElementById("announce").textContent = message;
}
