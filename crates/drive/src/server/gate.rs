//! Who may connect: programs of this user that know the token, from pages of this server alone.

use axum::http::header::{COOKIE, HOST, ORIGIN};
use axum::http::{HeaderMap, StatusCode};
use rand::TryRng;
use rand::rngs::SysRng;

use crate::error::DriveError;

/// Name of the cookie that holds the token.
const COOKIE_NAME: &str = "pskel";

/// Token and host names of a server.
#[derive(Clone, Debug)]
pub(crate) struct Gate {
    token: String,
    /// Host names, without ports: tunnels have other ports.
    hosts: Vec<String>,
}

/// Refusal: status and one line.
pub(crate) type Refusal = (StatusCode, &'static str);

impl Gate {
    /// Creates a gate with a new token for a server at an address.
    pub(crate) fn new(address: std::net::SocketAddr) -> Result<Self, DriveError> {
        let mut bytes = [0; 16];
        SysRng.try_fill_bytes(&mut bytes).map_err(|_| DriveError::Token)?;
        let token = bytes.iter().map(|byte| format!("{byte:02x}")).collect();
        let own = match address.ip() {
            std::net::IpAddr::V6(ip) => format!("[{ip}]"),
            std::net::IpAddr::V4(ip) => ip.to_string(),
        };
        let mut hosts = vec![own];
        if address.ip().is_loopback() {
            hosts.extend(["127.0.0.1", "localhost", "[::1]"].map(str::to_owned));
        }
        Ok(Self { token, hosts })
    }

    /// Returns the token, 32 hexadecimal digits.
    pub(crate) fn token(&self) -> &str {
        &self.token
    }

    /// Returns the cookie with the token.
    pub(crate) fn cookie(&self) -> String {
        format!("{COOKIE_NAME}={}; HttpOnly; SameSite=Strict; Path=/", self.token)
    }

    /// Checks that a request is for this server and not sent by another site's page.
    pub(crate) fn check_origin(&self, headers: &HeaderMap) -> Result<(), Refusal> {
        let text =
            |name| headers.get(name).map(|value: &axum::http::HeaderValue| value.to_str().unwrap_or(""));
        let host = text(HOST).unwrap_or_default();
        let name = match host.rsplit_once(':') {
            Some((name, port)) if port.bytes().all(|byte| byte.is_ascii_digit()) => name,
            _ => host,
        };
        // Another name may have been made to lead here (DNS rebinding).
        if !self.hosts.iter().any(|known| known == name) {
            return Err((
                StatusCode::FORBIDDEN,
                "expected the Host that the server listens on, found another",
            ));
        }
        match text(ORIGIN) {
            Some(origin) if origin != format!("http://{host}") => Err((
                StatusCode::FORBIDDEN,
                "expected a request of this server's page, found one of another site",
            )),
            _ => Ok(()),
        }
    }

    /// Checks the token too, in the query or in the cookie.
    pub(crate) fn check(&self, headers: &HeaderMap, token: Option<&str>) -> Result<(), Refusal> {
        self.check_origin(headers)?;
        let cookies = headers.get_all(COOKIE).iter().filter_map(|value| value.to_str().ok());
        let mut cookies =
            cookies.flat_map(|text| text.split(';')).filter_map(|pair| pair.trim().split_once('='));
        let has_cookie = cookies.any(|(name, value)| name == COOKIE_NAME && self.is_token(value));
        match has_cookie || token.is_some_and(|token| self.is_token(token)) {
            true => Ok(()),
            false => Err((
                StatusCode::FORBIDDEN,
                "expected the token of the printed address, found none or another",
            )),
        }
    }

    /// Compares in a time that does not depend on the place of the first difference.
    fn is_token(&self, found: &str) -> bool {
        let differences = self.token.bytes().zip(found.bytes()).fold(0, |all, (a, b)| all | (a ^ b));
        found.len() == self.token.len() && differences == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn headers(pairs: &[(&str, &str)]) -> HeaderMap {
        let parsed = |(name, value): &(&str, &str)| {
            let name: axum::http::HeaderName = name.parse().unwrap();
            (name, value.parse().unwrap())
        };
        pairs.iter().map(parsed).collect()
    }

    #[test]
    fn requests_need_token_host_and_origin() {
        let gate = Gate::new("127.0.0.1:8080".parse().unwrap()).unwrap();
        let token = gate.token().to_owned();
        assert_eq!(token.len(), 32);
        let cookie = format!("a=b; pskel={token}");
        let good: [&[(&str, &str)]; 4] = [
            &[("host", "127.0.0.1:8080"), ("cookie", &cookie)],
            &[("host", "localhost:9000"), ("cookie", &cookie), ("origin", "http://localhost:9000")],
            &[("host", "[::1]:8080"), ("cookie", &cookie)],
            &[("host", "localhost"), ("cookie", &cookie)],
        ];
        for pairs in good {
            assert_eq!(gate.check(&headers(pairs), None), Ok(()), "{pairs:?}");
        }
        let host = ("host", "127.0.0.1:8080");
        assert_eq!(gate.check(&headers(&[host]), Some(&token)), Ok(()));
        let bad: [&[(&str, &str)]; 6] = [
            &[],
            &[host],
            &[host, ("cookie", "pskel=")],
            &[host, ("cookie", &cookie[..cookie.len() - 1])],
            &[("host", "evil.example:8080"), ("cookie", &cookie)],
            &[host, ("cookie", &cookie), ("origin", "http://evil.example")],
        ];
        for pairs in bad {
            assert!(gate.check(&headers(pairs), None).is_err(), "{pairs:?}");
        }
        assert!(gate.check(&headers(&[host]), Some("0")).is_err());
        assert!(gate.check(&headers(&[host, ("origin", "null")]), Some(&token)).is_err());
        assert_ne!(Gate::new("127.0.0.1:0".parse().unwrap()).unwrap().token(), token);
    }
}
