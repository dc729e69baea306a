// What the theme's script puts in: each block's copy button has a name of its own, tables that scroll are reached by keyboard.
new MutationObserver(() => {
  document.querySelectorAll(".md-code__nav").forEach((nav, i) => nav.setAttribute("aria-label", `Code ${i + 1}`));
  document.querySelectorAll(".md-typeset__scrollwrap").forEach((table) => { table.tabIndex = 0; });
}).observe(document.documentElement, { childList: true, subtree: true });
