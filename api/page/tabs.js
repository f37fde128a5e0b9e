// What the tabs of one browser share: of each alarm one of them gives sound and notification, and what is acknowledged
// in one is seen in all. A database for the first, since locks are not there on a page without TLS.
const SHARED = `kerntemp-alarms:${location.pathname}`; // several Kerntemps may stand behind one address
const STORE = "announced";
const channel = new BroadcastChannel(SHARED);

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

let opened = null;
const close = () => {
  opened?.then((database) => database.close(), () => { /* it never opened */ });
  opened = null;
};

async function open() {
  const request = indexedDB.open(SHARED, 1);
  request.onupgradeneeded = () => request.result.createObjectStore(STORE);
  const database = await new Promise((resolve, reject) => {
    request.onsuccess = () => resolve(request.result);
    request.onerror = () => reject(request.error);
  });
  database.onclose = database.onversionchange = close;
  return database;
}

// Replaces what the tabs know of a way, in one transaction, which no other tab's comes between; returns what it was.
async function exchange(way, following) {
  try {
    const transaction = (await (opened ??= open())).transaction(STORE, "readwrite");
    const store = transaction.objectStore(STORE);
    const reading = store.get(way);
    reading.onsuccess = () => store.put(following(reading.result), way);
    await new Promise((resolve, reject) => {
      transaction.oncomplete = resolve;
      transaction.onabort = () => reject(transaction.error);
    });
    return reading.result;
  } catch {
    close(); // the next look tries again
    return undefined;
  }
}

const numberOf = ({ id }) => Number(id);
const raisedAt = ({ raised_utc: utc }) => Date.parse(utc);
const upTo = (known, alarms) => ({ number: Math.max(known?.number ?? 0, ...alarms.map(numberOf)), raised: Math.max(known?.raised ?? 0, ...alarms.map(raisedAt)) });

// Before there was a database a browser kept the number of the newest alarm.
const NEWEST = "kerntemp-alarm-newest";
const kept = localStorage.getItem(NEWEST);
const before = kept === null ? null : { number: Number(kept), raised: Date.now() };
localStorage.removeItem(NEWEST);

// What this tab has seen itself counts as well, and alone where there is no database or an empty one: rather twice than
// never. Null where a way was switched on since.
const own = new Map();
function known(way, shared) {
  const mine = own.has(way) ? own.get(way) : before;
  if (!shared || !mine) return shared === undefined ? mine : shared;
  return { number: Math.max(shared.number, mine.number), raised: Math.max(shared.raised, mine.raised) };
}

// Which of these alarms are this tab's to announce in a way: those newer than any that a tab has taken for itself, by
// their number or, where another store counts from one again, by their time. The first look takes nothing.
export async function claim(way, alarms) {
  const seen = known(way, await exchange(way, (shared) => upTo(known(way, shared), alarms)));
  own.set(way, upTo(seen, alarms));
  return seen ? alarms.filter((one) => numberOf(one) > seen.number || raisedAt(one) > seen.raised) : [];
}

// What stands now is known: where a way is switched on, only what comes after it is announced.
export async function forget(way) {
  own.set(way, null);
  await exchange(way, () => null);
}
