# $made
# Stack of the deepest chain of calls, from what gcc -fcallgraph-info=su writes: own frames, by the function that begins.
function deepest(name,    called, count, i, most, below) {
    count = split(calls[name], called, SUBSEP)
    for (i = 2; i <= count; i++) {
        below = called[i] in own ? deepest(called[i]) : 0
        if (!(called[i] in own))
            outside[called[i]]
        if (below > most)
            most = below
    }
    return own[name] + most
}
/^node:/ {
    split($$0, part, "\"")
    if (match(part[4], /[0-9]+ bytes/))
        own[part[2]] = substr(part[4], RSTART, RLENGTH) + 0
    if (part[4] ~ /dynamic,|dynamic\)/)
        print "of no fixed size: " part[2]
}
/^edge:/ {
    split($$0, part, "\"")
    calls[part[2]] = calls[part[2]] SUBSEP part[4]
}
END {
    for (name in own)
        if (name !~ /:/)
            print name ": " deepest(name) " bytes of stack"
    for (name in outside)
        said = said " " name
    print "beside it what these take of the library:" (said ? said : " none")
}
