// Files on their way to the server: in pieces, some side by side, with progress; a piece that is lost is sent again.
import { ask, Refused, send } from "../../shared/net";

const PIECE = 2 * 2 ** 20, SIDE_BY_SIDE = 3, TRIES = 6, WAIT_MS = 700;
export interface Given { file: File; name: string }

/** All files of what was dropped, folders included. */
export async function dropped(items: DataTransferItemList): Promise<Given[]> {
  // Entries are only there during the event; the rest is asked for afterwards.
  const entries = [...items].map((item) => item.webkitGetAsEntry()).filter((entry) => entry !== null);
  const found: Given[] = [];
  const walk = async (entry: FileSystemEntry): Promise<void> => {
    if (entry.isFile) {
      const file = await new Promise<File>((done, failed) => (entry as FileSystemFileEntry).file(done, failed));
      found.push({ file, name: entry.fullPath.replace(/^\//, "") });
    } else if (entry.isDirectory) {
      const reader = (entry as FileSystemDirectoryEntry).createReader();
      for (;;) {
        const some = await new Promise<FileSystemEntry[]>((done, failed) => reader.readEntries(done, failed));
        if (!some.length) break;
        for (const one of some) await walk(one);
      }
    }
  };
  for (const entry of entries) await walk(entry);
  return found;
}

export const chosen = (files: FileList): Given[] => [...files].map((file) => ({ file, name: file.webkitRelativePath || file.name }));

/** Send all files; returns the upload's key. */
export async function upload(given: Given[], signal: AbortSignal, progress: (done: number, total: number) => void): Promise<string> {
  const total = given.reduce((sum, { file }) => sum + file.size, 0), { key } = await send<{ key: string }>("POST", "/api/uploads");
  const dicom = given.filter(({ name }) => !name.split("/").some((part) => part.startsWith(".")));
  for (let first = 0; first < dicom.length; first += 1000) {
    const files = dicom.slice(first, first + 1000).map(({ file, name }) => ({ name, size: file.size }));
    await send("POST", `/api/uploads/${key}/files`, { files });
  }
  let done = 0, next = 0;
  const worker = async (): Promise<void> => {
    while (next < dicom.length) {
      const number = next++, { file } = dicom[number] as Given;
      let at = 0;
      while (at < file.size) {
        const come = await piece(`/api/uploads/${key}/files/${number}`, file, at, signal);
        done += come - at;
        at = come;
        progress(done, total);
      }
    }
  };
  try {
    await Promise.all(Array.from({ length: SIDE_BY_SIDE }, worker));
  } catch (error) {
    void ask("DELETE", `/api/uploads/${key}`).catch(() => undefined);
    throw error;
  }
  return key;
}

async function piece(path: string, file: File, at: number, signal: AbortSignal): Promise<number> {
  for (let tries = 1; ; tries++) {
    try {
      const answer = await ask("PUT", `${path}/${at}`, file.slice(at, at + PIECE), signal);
      return ((await answer.json()) as { come: number }).come;
    } catch (error) {
      const goOn = error instanceof Refused && error.status === 409 ? /at (\d+)/.exec(error.message) : null;
      if (goOn) return Number(goOn[1]);
      if (signal.aborted || tries >= TRIES || (error instanceof Refused && error.status < 500)) throw error;
      await new Promise((wait) => setTimeout(wait, WAIT_MS * tries));
    }
  }
}
