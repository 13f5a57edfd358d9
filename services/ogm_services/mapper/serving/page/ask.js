// Requests to the mapper. Every address is relative to the page's: a proxy may have put it below a path.

const TIMEOUT_MS = 10000;

export const ask = (path, options = {}) =>
  fetch(path, {cache: "no-store", signal: AbortSignal.timeout(TIMEOUT_MS), ...options});

// What a route says in JSON; an error says which route failed and how.
export async function askJson(path, options) {
  const reply = await ask(path, options);
  const text = await reply.text();  // also of a refusal: unread it would keep its connection until the timeout
  if (!reply.ok) throw new Error(`${path.split("?")[0]}: ${reply.status}`);
  return JSON.parse(text);
}
