/// Returns the peak memory of this process so far, bytes; `None` if the system does not report it.
pub(super) fn peak_rss_bytes() -> Option<u64> {
    peak_of_status(&std::fs::read_to_string("/proc/self/status").ok()?)
}

/// Parses the line `VmHWM: N kB` of Linux' `/proc/PID/status`; its kB are 1024 bytes.
fn peak_of_status(status: &str) -> Option<u64> {
    let rest = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    rest.trim().strip_suffix("kB")?.trim_end().parse::<u64>().ok()?.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parses_peak_memory() {
        let status = "Name:\tpskel\nVmPeak:\t  999 kB\nVmHWM:\t   81416 kB\nVmRSS:\t   10 kB\n";
        assert_eq!(peak_of_status(status), Some(81_416 * 1024));
        for text in
            ["", "VmRSS:\t10 kB", "VmHWM:\t10 MB", "VmHWM:\t-1 kB", "VmHWM:", "VmHWM: 99999999999999999 kB"]
        {
            assert_eq!(peak_of_status(text), None, "{text}");
        }
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn peak_memory_exceeds_one_mebibyte() {
        assert!(peak_rss_bytes().unwrap() > 1 << 20);
    }
}
