// Light, dark, or as the system: one choice for all pages of this origin.
const THEME = "spinestiff-theme";

export function theme(select: HTMLSelectElement): void {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  select.value = localStorage.getItem(THEME) ?? "auto";
  const apply = (): void => {
    document.documentElement.dataset["theme"] = select.value === "auto" ? (dark.matches ? "dark" : "light") : select.value;
  };
  select.addEventListener("change", () => { localStorage.setItem(THEME, select.value); apply(); });
  dark.addEventListener("change", apply);
  apply();
}
