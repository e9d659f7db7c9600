//! Command line that writes the maps on the page.

/// Returns a command line of arguments, quoted for a POSIX shell.
pub(super) fn line(arguments: impl IntoIterator<Item = String>) -> String {
    let quoted: Vec<String> = arguments.into_iter().map(|argument| quoted(&argument)).collect();
    quoted.join(" ")
}

fn quoted(argument: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./:=,@%+".contains(c);
    if !argument.is_empty() && argument.chars().all(is_plain) {
        return argument.to_owned();
    }
    format!("'{}'", argument.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_are_quoted() {
        let arguments = ["pskel", "--at=5", "a b", "nuscenes:x#y", "it's", ""].map(str::to_owned);
        assert_eq!(line(arguments), r"pskel --at=5 'a b' 'nuscenes:x#y' 'it'\''s' ''");
    }
}
