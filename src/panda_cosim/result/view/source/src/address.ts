// The fragment of the page's address: the time and the camera.

export interface Place {
  at?: number;
  camera?: string;
}

/** Read `#t=2.3&cam=front`. */
export function readAddress(hash: string): Place {
  const asked = new URLSearchParams(hash.replace(/^#/, ""));
  const time = asked.has("t") ? Number(asked.get("t")) : NaN;
  const camera = asked.get("cam");
  return { ...(Number.isFinite(time) && { at: time }), ...(camera !== null && { camera }) };
}

/** Write it; commas of a free view stay readable. */
export function writeAddress({ at, camera }: Required<Place>): string {
  return `#t=${Number(at.toFixed(4))}&cam=${encodeURIComponent(camera).replaceAll("%2C", ",")}`;
}

/** Keep the address up to date, a few times a second at most. */
export function keepAddress(place: () => Required<Place>): () => void {
  let waiting = 0;
  return () => {
    waiting ||= window.setTimeout(() => {
      waiting = 0;
      try {
        history.replaceState(null, "", writeAddress(place()));
      } catch {
        // A frame without its own address, as in a notebook.
      }
    }, 250);
  };
}
