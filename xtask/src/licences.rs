//! Whether every dependency's licence is one that we accept.
//!
//! The list of accepted licences is the one in `deny.toml`, so that cargo-deny and this check cannot disagree. The
//! check is here because it costs nothing: cargo tells the licences, and cargo-deny takes minutes to install.

use std::collections::BTreeSet;

use crate::shell::{self, Context, Failure, Result, say};
use crate::workspace;

/// Checks the licences of everything in the workspace's graph, for every system.
pub fn check() -> Result<()> {
    let file = workspace::root().join("deny.toml");
    let text = std::fs::read_to_string(&file).context(|| format!("cannot read {}", file.display()))?;
    let accepted = accepted(&text)
        .ok_or_else(|| Failure::new(format!("{}: there is no list `allow` of licences", file.display())))?;
    let mut cargo = workspace::cargo();
    cargo.args(["tree", "--locked", "--workspace", "--target", "all", "--edges", "normal,build,dev"]);
    let output = shell::quietly(cargo.args(["--prefix", "none", "--format", "{p}|{l}"]))?;
    let listed = String::from_utf8_lossy(&output.stdout).into_owned();
    // The second time that a package occurs, cargo marks it.
    let packages: BTreeSet<(&str, &str)> =
        listed.lines().filter_map(|line| line.trim_end_matches(" (*)").split_once('|')).collect();
    let refused: Vec<String> = packages
        .iter()
        .filter(|(_, licence)| !Expression::of(licence).holds(&accepted))
        .map(|(package, licence)| {
            format!("{package}: {}", if licence.is_empty() { "no licence" } else { licence })
        })
        .collect();
    if !refused.is_empty() {
        return Err(Failure::new(format!(
            "licences that deny.toml does not accept:\n  {}\nLeave these crates out, or add the licence there if it is \
             permissive",
            refused.join("\n  ")
        )));
    }
    say(&format!("licences of {} packages: all accepted", packages.len()));
    Ok(())
}

/// The strings of the list `allow` in the section `[licenses]`.
fn accepted(deny: &str) -> Option<BTreeSet<String>> {
    let (_, section) = deny.split_once("[licenses]")?;
    let (_, list) = section.split_once("allow = [")?;
    let (list, _) = list.split_once(']')?;
    Some(list.split('"').skip(1).step_by(2).map(str::to_owned).collect())
}

/// An SPDX licence expression, read word by word. Older manifests write `/` for `OR`.
struct Expression {
    words: Vec<String>,
}

impl Expression {
    fn of(text: &str) -> Self {
        let spaced = text.replace('/', " OR ").replace('(', " ( ").replace(')', " ) ");
        let mut words: Vec<String> = Vec::new();
        let mut rest = spaced.split_whitespace();
        while let Some(word) = rest.next() {
            // An exception belongs to its licence.
            match (word, words.last_mut()) {
                ("WITH", Some(licence)) => {
                    licence.push_str(" WITH ");
                    licence.push_str(rest.next().unwrap_or_default());
                }
                _ => words.push(word.to_owned()),
            }
        }
        Self { words }
    }

    /// Whether the terms can be met with these licences; an empty or broken expression cannot.
    fn holds(&self, accepted: &BTreeSet<String>) -> bool {
        let mut at = 0;
        self.any(&mut at, accepted).is_some_and(|holds| holds && at == self.words.len())
    }

    /// `a OR b`
    fn any(&self, at: &mut usize, accepted: &BTreeSet<String>) -> Option<bool> {
        let mut holds = self.all(at, accepted)?;
        while self.words.get(*at).is_some_and(|word| word == "OR") {
            *at += 1;
            holds |= self.all(at, accepted)?;
        }
        Some(holds)
    }

    /// `a AND b`, which binds closer.
    fn all(&self, at: &mut usize, accepted: &BTreeSet<String>) -> Option<bool> {
        let mut holds = self.one(at, accepted)?;
        while self.words.get(*at).is_some_and(|word| word == "AND") {
            *at += 1;
            holds &= self.one(at, accepted)?;
        }
        Some(holds)
    }

    fn one(&self, at: &mut usize, accepted: &BTreeSet<String>) -> Option<bool> {
        let word = self.words.get(*at)?;
        *at += 1;
        match word.as_str() {
            "(" => {
                let holds = self.any(at, accepted)?;
                let closes = self.words.get(*at).is_some_and(|word| word == ")");
                *at += 1;
                closes.then_some(holds)
            }
            ")" | "OR" | "AND" => None,
            licence => Some(accepted.contains(licence)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn our_own_dependencies_pass() {
        check().unwrap();
    }

    #[test]
    fn expressions_are_understood() {
        let accepted =
            accepted("[licenses]\nallow = [\n \"MIT\",\n \"Zlib\", \"Apache-2.0 WITH LLVM-exception\",\n]\n")
                .unwrap();
        let holds = |text: &str| Expression::of(text).holds(&accepted);
        for good in [
            "MIT",
            "GPL-3.0 OR MIT",
            "GPL-3.0/MIT",
            "MIT AND Zlib",
            "(GPL-3.0 OR MIT) AND Zlib",
            "Apache-2.0 WITH LLVM-exception",
            "GPL-3.0 OR MIT AND Zlib",
        ] {
            assert!(holds(good), "{good}");
        }
        for bad in [
            "",
            "GPL-3.0",
            "MIT AND GPL-3.0",
            "(MIT OR Zlib) AND GPL-3.0",
            "Apache-2.0",
            "MIT WITH LLVM-exception",
            "(MIT",
            "MIT)",
            "MIT Zlib",
            "OR MIT",
        ] {
            assert!(!holds(bad), "{bad}");
        }
    }
}
