// What a channel measures, by its name; the press now says it itself (role).
export function roleOf(name) {
  return name.startsWith("platen") ? "platen" : name.startsWith("top") ? "top" : name.startsWith("bottom") ? "bottom" : name.startsWith("core") ? "core" : "other";
}
