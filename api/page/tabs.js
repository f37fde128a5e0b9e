// What the tabs of one browser share: of each alarm one of them gives sound and notification, and what is acknowledged
// in one is seen in all. A database for the first, since locks are not there on a page without TLS.
const STORE = "announced";
const channel = new BroadcastChannel("kerntemp-alarms");

// `listener(alarm)`: an alarm was acknowledged in another tab, or in this one; returns what ends it.
export function onTaken(listener) {
  const heard = (event) => listener(event.data);
  channel.addEventListener("message", heard);
  return () => channel.removeEventListener("message", heard);
}

// BroadcastChannel reaches all but the one that calls.
export function taken(alarm) {
  channel.postMessage(alarm);
  channel.dispatchEvent(new MessageEvent("message", { data: alarm }));
}

const done = (request) => new Promise((resolve, reject) => {
  request.onsuccess = () => resolve(request.result);
  request.onerror = () => reject(request.error);
});

let opened = null;
function database() {
  const request = indexedDB.open("kerntemp-alarms", 1);
  request.onupgradeneeded = () => request.result.createObjectStore(STORE);
  return done(request);
}

const numberOf = ({ id }) => Number(id);
const raisedAt = ({ raised_utc: utc }) => Date.parse(utc);

// Which of these alarms are this tab's to announce in a way: those newer than any that a tab has taken for itself, by
// their number or, where another store counts from one again, by their time. Reading and writing are one transaction,
// which no other tab's comes between. The first look takes nothing.
export async function claim(way, alarms) {
  const store = (await (opened ??= database())).transaction(STORE, "readwrite").objectStore(STORE);
  const before = await done(store.get(way));
  const known = before ?? { number: 0, raised: 0 };
  await done(store.put({ number: Math.max(known.number, ...alarms.map(numberOf)), raised: Math.max(known.raised, ...alarms.map(raisedAt)) }, way));
  return before ? alarms.filter((one) => numberOf(one) > known.number || raisedAt(one) > known.raised) : [];
}

// What stands now is known: where a way is switched on, only what comes after it is announced.
export async function forget(way) {
  const store = (await (opened ??= database())).transaction(STORE, "readwrite").objectStore(STORE);
  await done(store.delete(way));
}
