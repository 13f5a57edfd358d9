// Who may change the map: the page asks for the mapper's token once, when a change wants it.
import {ask as request, askJson} from "./ask.js";
import {ask as question} from "./dialogs.js";
import {change, state} from "./state.js";

const UNAUTHORIZED = 401;

// What a refusal says in its problem details.
async function reasonOf(reply) {
  try {
    return (await reply.json()).detail ?? `${reply.status} ${reply.statusText}`;
  } catch {
    return `${reply.status} ${reply.statusText}`;
  }
}

export const refreshAccess = async () => change("access", await askJson("login"));

async function logIn(token) {
  const headers = {"Content-Type": "application/json"};
  const reply = await request("login", {method: "POST", headers, body: JSON.stringify({token})});
  if (!reply.ok) throw new Error(reply.status === UNAUTHORIZED ? "That is not the mapper's token." : await reasonOf(reply));
  await refreshAccess();
  return true;
}

export async function logOut() {
  await request("logout", {method: "POST"});
  await refreshAccess();
}

const askForToken = () => question({
  title: "The mapper's token", label: "token", confirm: "Log in", attempt: logIn,
  text: "Who changes this map shows the token of the mapper's settings. This browser then stays logged in for twelve hours.",
  input: {type: "password", autocomplete: "current-password", name: "token"},
});

// Ask for a change by POST; what the mapper says of it, or null: whoever was asked for the token has given up.
export async function write(path) {
  if (state.access?.token_needed && !state.access.logged_in && !await askForToken()) return null;
  let reply = await request(path, {method: "POST"});
  if (reply.status === UNAUTHORIZED) {  // the mapper was started again since, and forgets who was logged in
    if (!await askForToken()) return null;
    reply = await request(path, {method: "POST"});
  }
  if (!reply.ok) throw new Error(await reasonOf(reply));
  return reply.json();
}
