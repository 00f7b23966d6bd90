// What a page asks of its server, always with this start's token. Nothing is asked of anybody else.
const KEY = "spinestiff-token", BEHIND_PROXY = "proxy", TOKEN = /^[\w-]{20,}$/;

export class Refused extends Error {
  constructor(readonly status: number, message: string) { super(message); }
}

/** The token comes in the fragment, which no server sees, and is kept for reloads of this tab alone. */
export function takeToken(): void {
  const given = location.hash.slice(1);
  // Another start's address in a tab that shows this page: the browser itself loads nothing.
  addEventListener("hashchange", () => { if (TOKEN.test(location.hash.slice(1))) location.reload(); });
  if (!TOKEN.test(given)) return;
  sessionStorage.setItem(KEY, given);
  history.replaceState(null, "", location.pathname);
}

/** An answer, or Refused with the server's words. Addresses are relative to the page. */
export async function ask(method: string, path: string, body?: string | Blob, signal?: AbortSignal): Promise<Response> {
  const headers: Record<string, string> = { "x-spinestiff-token": sessionStorage.getItem(KEY) ?? BEHIND_PROXY };
  if (body !== undefined) headers["content-type"] = typeof body === "string" ? "application/json" : "application/octet-stream";
  const answer = await fetch(path, { method, headers, ...(body === undefined ? {} : { body }), ...(signal ? { signal } : {}) });
  if (answer.ok) return answer;
  let why = `the server answered ${answer.status}`;
  try { why = ((await answer.json()) as { error?: string }).error ?? why; } catch { /* no JSON: the number says it */ }
  throw new Refused(answer.status, why);
}

export const get = async <T>(path: string): Promise<T> => (await (await ask("GET", path)).json()) as T;
export const send = async <T>(method: string, path: string, data: unknown = {}): Promise<T> =>
  (await (await ask(method, path, JSON.stringify(data))).json()) as T;

export const words = (error: unknown): string =>
  error instanceof Refused ? error.message : error instanceof TypeError ? "The server does not answer. Is the program still running?" : String(error);

/** Server-sent events, read by fetch: an EventSource can't send the token. Ends with the stream or the signal. */
export async function events(path: string, signal: AbortSignal, take: (name: string, data: unknown, id: string) => void): Promise<void> {
  const answer = await ask("GET", path, undefined, signal), reader = answer.body?.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "";
  for (;;) {
    const piece = await reader?.read();
    if (!piece || piece.done) return;
    rest += piece.value;
    const blocks = rest.split("\n\n");
    rest = blocks.pop() ?? "";
    for (const block of blocks) {
      const fields = Object.fromEntries(block.split("\n").map((line) => line.split(/: (.*)/s).slice(0, 2) as [string, string]));
      if (fields["event"]) take(fields["event"], JSON.parse(fields["data"] ?? "null"), fields["id"] ?? "");
    }
  }
}
