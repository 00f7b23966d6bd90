// Grey values of a radiograph as a server sends them.

/** What the header of an answer says of its picture, and the picture's grey values, row by row. */
export async function greysIn<T>(answer: Response): Promise<T & { levels: Uint16Array }> {
  const about = JSON.parse(answer.headers.get("x-radiograph") ?? "{}") as T;
  // Sent little endian, which is the order of every machine that runs a browser.
  return { ...about, levels: new Uint16Array(await answer.arrayBuffer()) };
}
